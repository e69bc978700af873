"""The numbers of one reconstruction: ``metrics.json``, for people, for the report and for other programs."""

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from recon.errors import ReconError

METRICS_NAME = "metrics.json"


class Part(BaseModel):
    """Common behaviour: unchangeable, no unknown field."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Verdict(Part):
    """The first thing a person reads: pass, check or fail, why, and what to do next."""

    grade: Literal["pass", "check", "fail"]
    reasons: tuple[str, ...]
    next_action: str


class Funnel(Part):
    """How many pixels are left after each step."""

    pixels: int
    lit: int  # saw the stripe in at least one set
    matched: int  # have a correspondence in all sets
    entry_points: int  # the FEP passed every test
    normals: int


class Statistic(Part):
    """Spread of one quantity over the pixels that have a point. ``unit`` is written as in the report (mm, deg, px)."""

    name: str
    unit: str
    mean: float
    median: float
    rms: float
    p95: float
    how: str  # how it was computed, in one sentence


class SampleCurve(Part):
    """One pixel's intensity over stripe places in one sweep, with what was made of it."""

    row: int
    col: int
    set: str
    axis: str
    place_px: tuple[float, ...]
    intensity: tuple[float, ...]
    model: tuple[float, ...]  # empty where the method fits no curve
    peak_px: float
    sd_px: float | None


class StageTime(Part):
    """Time and peak memory of one stage of the run."""

    name: str
    wall_s: float
    peak_mb: float
    kept: bool = False  # taken from an earlier run: nothing that it follows from had changed
    detail: str = ""  # what part of it was kept


class PhotoQuality(Part):
    """One photo in the strip of capture quality."""

    set: str
    sweep: str
    index: int
    brightest: float
    saturated_share: float


class ScenePart(Part):
    """How one part of the picture changed between two reference photos."""

    name: Literal["marks", "display", "object"]
    shift_px: float
    sd_px: float
    spread_px: float
    light: float
    light_sd: float


class SceneComparison(Part):
    """A reference photo beside the first one of its set or, ``across_sets``, the session's. ``error_mm``: see outputs.md."""

    set: str
    index: int
    across_sets: bool
    parts: tuple[ScenePart, ...]
    findings: tuple[str, ...]
    error_mm: float | None


class DoubtfulRange(Part):
    """Device pixels, first and last included, that so many pixels of a set see but cannot place: worth an ordinary sweep."""

    set: str
    axis: Literal["x", "y"]
    first_px: int
    last_px: int
    pixels: int


class DisplayMotion(Part):
    """How the display moved in its plane at one position between air and liquid, each with its standard deviation."""

    position: Literal[0, 1]
    x_mm: float
    x_sd_mm: float
    y_mm: float
    y_sd_mm: float
    turn_deg: float
    turn_sd_deg: float


class RegistrationRecord(Part):
    """What the gaps said of the displays in liquid, and whether the poses were corrected by it.

    ``gap_before`` and ``gap_after``: the normalised gap (robust rms of gap over its sd) with the poses as given, and with
    the motions. ``directions`` of the six numbers were determined by the gaps; the others stay as given.
    """

    applied: bool
    sigma: float
    conflict_sigma: float
    directions: int
    gap_before: float
    gap_after: float
    motions: tuple[DisplayMotion, DisplayMotion]


class BoardSet(Part):
    """The board's corners in one set: found, left out as seen through the object, used; ``rms_px`` None where none was."""

    set: str
    photos: int
    found: int
    through_object: int
    used: int
    rms_px: float | None


class DisplaySlip(Part):
    """How the display stood in the liquid set beside the dry one of a position, along its own axes; each with its sd."""

    position: int
    in_plane_mm: float
    in_plane_sd_mm: float
    turn_deg: float
    turn_sd_deg: float
    along_normal_mm: float
    along_normal_sd_mm: float
    sigma: float
    found: bool


class BoardResult(Part):
    """What the session's own photos of a board say of the display; ``source`` is what was known before."""

    sets: tuple[BoardSet, ...]
    slips: tuple[DisplaySlip, ...]
    corner_sd_px: float
    source: str
    sentences: tuple[str, ...]


class LiquidIndexRecord(Part):
    """The liquid's index: what was used and why, and what the session itself shows (null where it does not).

    ``sd`` is that of a measured index, null for a stated one. ``level``: by the liquid's flat surface beside the object;
    ``chords``: by the object's own points and normals.
    """

    n: float
    sd: float | None
    source: str
    level_n: float | None
    level_sd: float | None
    chords_n: float | None
    chords_sd: float | None
    contradicted: bool


class TwoPathCount(Part):
    """How many pixels see the display by two light paths, and how many of them have a point all the same."""

    pixels: int
    points: int


class Metrics(Part):
    """All that ``metrics.json`` holds."""

    schema_version: Literal[1] = 1
    session: str
    method: Literal["paper", "full"]
    length_unit: str
    verdict: Verdict
    funnel: Funnel
    status_counts: dict[str, int]
    statistics: tuple[Statistic, ...]
    parameters: dict[str, object]
    warnings: tuple[str, ...]
    versions: dict[str, str]
    hashes: dict[str, str]
    stages: tuple[StageTime, ...]
    curves: tuple[SampleCurve, ...] = ()
    photos: tuple[PhotoQuality, ...] = ()
    scene: tuple[SceneComparison, ...] = ()
    scene_note: str = ""
    doubtful_ranges: tuple[DoubtfulRange, ...] = ()
    registration: RegistrationRecord | None = None
    board: BoardResult | None = None
    board_note: str = ""
    liquid_index: LiquidIndexRecord | None = None
    two_paths: TwoPathCount | None = None


def save_metrics(metrics: Metrics, path: Path) -> None:
    """Write ``metrics.json``."""
    path.write_text(metrics.model_dump_json(indent=2) + "\n", encoding="utf-8")


def load_metrics(path: Path) -> Metrics:
    """Read ``metrics.json``; raises ``ReconError`` with one sentence where it cannot be used."""
    try:
        return Metrics.model_validate_json(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ReconError(f"{path}: no such file; run `recon run` on the session first") from None
    except (OSError, UnicodeDecodeError, ValidationError) as error:
        raise ReconError(f"{path}: not the metrics of a reconstruction ({str(error).splitlines()[0]})") from None
