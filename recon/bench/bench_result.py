"""What one run of the benchmark gives, kept as JSON."""

from pydantic import BaseModel, ConfigDict


class Part(BaseModel):
    """A part of a result: immutable, and strict about its fields."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Machine(Part):
    """Where it was measured, and what else the machine was doing: the load averages over one minute."""

    processor: str
    cores: int
    memory_gb: float
    system: str
    load_before: float
    load_after: float


class Photos(Part):
    """Photos of one size, as they turned out."""

    wanted_mb: float
    file_mb: float
    quality: int
    photos: int
    columns: int
    rows: int


class Measurement(Part):
    """One contestant, once in each of ``threads`` threads at the same time; megabytes are 10⁶ bytes.

    ``at_start_mb`` is the peak before it began, with every library loaded, ``peak_mb`` the peak at its end.
    """

    contestant: str
    photos: int
    file_mb: float
    threads: int
    wall_s: float
    processor_s: float
    megapixels_per_s: float
    at_start_mb: float
    peak_mb: float


class Ratio(Part):
    """How many times longer a contestant took than another, on the same files with the same threads."""

    contestant: str
    over: str
    file_mb: float
    threads: int
    wall: float
    processor: float


class Agreement(Part):
    """The share of the pixels that our sweep places for which it lies within half a step of another's brightest photo."""

    contestant: str
    share: float


class BenchResult(Part):
    """Everything that one run measured."""

    command: str
    machine: Machine
    versions: dict[str, str]
    photos: tuple[Photos, ...]
    measurements: tuple[Measurement, ...]
    ratios: tuple[Ratio, ...]
    agreement: tuple[Agreement, ...]
    notes: tuple[str, ...]
