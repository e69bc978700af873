"""What ``recon bench run`` gives, kept as JSON."""

from recon.bench.bench_result import Machine, Part


class RunPhotos(Part):
    """The session: four sets of two sweeps of ``photos_a_sweep`` photos, as they turned out."""

    file_mb: float
    quality: int
    photos: int
    photos_a_sweep: int
    columns: int
    rows: int
    object_megapixels: float


class RunStage(Part):
    """One stage: ``peak_mb`` is the process's peak up to its end, in 10⁶ bytes."""

    name: str
    wall_s: float
    processor_s: float
    peak_mb: float


class FoundSurface(Part):
    """How much of the object was found, and how far its points are from the surface that the scene has."""

    share: float
    error_rms_mm: float
    error_median_mm: float


class RunBenchResult(Part):
    """Everything that one run measured.

    ``decoding`` decodes every photo and does nothing else; ``run`` is the whole of ``recon run``, of which ``stages`` are the
    parts. ``over_decoding_wall`` and ``over_decoding_processor`` are their ratios.
    """

    command: str
    machine: Machine
    versions: dict[str, str]
    method: str
    threads: int
    photos: RunPhotos
    decoding: RunStage
    run: RunStage
    stages: tuple[RunStage, ...]
    over_decoding_wall: float
    over_decoding_processor: float
    surface: FoundSurface
