"""Comparison with truth, pixel by pixel, where a simulation wrote it down.

``truth.npz`` holds, on the camera grid, ``point_mm`` and ``normal`` [rows, cols, 3] and ``status`` [rows, cols], a
:class:`TruthStatus`. Truth from other programs may hold ``point`` for ``point_mm``, and ``judged`` with
``lit_in_all_sets`` (both boolean) for ``status``.
"""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64

from recon.errors import ReconError
from recon.evaluation.spread import Spread, angle_between_rad, spread_of
from recon.maps import Maps
from recon.sessions.session import TRUTH_NAME


class TruthStatus(IntEnum):
    """What the centre of a pixel sees, as ``truth.npz`` tells it."""

    JUDGED = 0
    MISSES_OBJECT = 1
    LOST_INSIDE = 2
    OFF_PANEL = 3
    RE_ENTERS = 4


LIT = (TruthStatus.JUDGED, TruthStatus.MISSES_OBJECT)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The true first entry point and normal of each judged pixel, and the pixels that see light in all four sets."""

    point_mm: Float64[np.ndarray, "rows cols 3"]
    normal: Float64[np.ndarray, "rows cols 3"]
    judged: Bool[np.ndarray, "rows cols"]
    lit: Bool[np.ndarray, "rows cols"]


@dataclass(frozen=True, slots=True)
class TruthComparison:
    """How a reconstruction does against truth.

    ``complete`` is the share of judged pixels with a point. ``false_points`` counts points at pixels whose path does not
    reach the display in all four sets, or has no one first entry point. ``normalised_rms`` is the rms of point errors over
    their own standard deviations, 1 where these are honest.
    """

    judged: int
    complete: float
    false_points: int
    point_mm: Spread
    normal_rad: Spread
    normalised_rms: float


def load_truth(path: Path) -> Truth:
    """Read a truth file, or that of a session's folder; raises ``ReconError`` where it cannot be used."""
    file = path / TRUTH_NAME if path.is_dir() else path
    try:
        # Opened here, since numpy leaves a file open that turns out not to be an archive.
        with file.open("rb") as stream, np.load(stream) as arrays:
            return _truth(arrays)
    except FileNotFoundError:
        raise ReconError(f"{file}: no such file; only simulated sessions carry their truth") from None
    except (OSError, EOFError, ValueError, KeyError, AttributeError, TypeError, zipfile.BadZipFile) as error:
        raise ReconError(f"{file}: not a truth file ({error})") from None


def _truth(arrays: Mapping[str, np.ndarray]) -> Truth:
    point_mm = arrays["point_mm" if "point_mm" in arrays else "point"].astype(np.float64)
    if "status" in arrays:
        judged, lit = arrays["status"] == TruthStatus.JUDGED, np.isin(arrays["status"], LIT)
    else:
        judged, lit = arrays["judged"].astype(bool), arrays["lit_in_all_sets"].astype(bool)
    normal = arrays["normal"].astype(np.float64)
    if point_mm.shape != normal.shape or point_mm.shape != (*judged.shape, 3) or judged.shape != lit.shape:
        raise ValueError(f"its maps differ in size: {point_mm.shape}, {normal.shape}, {judged.shape}, {lit.shape}")
    return Truth(point_mm, normal, judged, lit)


def compare_with_truth(maps: Maps, truth: Truth) -> TruthComparison:
    """Compare the points and normals of a reconstruction with the truth of the same pixels."""
    if truth.judged.shape != maps.status.shape:
        raise ReconError(
            f"the truth has {truth.judged.shape[0]} rows of {truth.judged.shape[1]} pixels, the reconstruction "
            f"{maps.status.shape[0]} of {maps.status.shape[1]}; give the truth of the same session"
        )
    found = judged_points(maps, truth)
    error_mm = np.linalg.norm(maps.point_mm[found] - truth.point_mm[found], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        normalised = error_mm / maps.sd_mm[found].astype(np.float64)
    judged = int(truth.judged.sum())
    return TruthComparison(
        judged=judged,
        complete=float(found.sum() / judged) if judged else np.nan,
        false_points=int((maps.valid() & ~truth.lit).sum()),
        point_mm=spread_of(error_mm),
        normal_rad=spread_of(angle_between_rad(maps.normal[found], truth.normal[found])),
        normalised_rms=spread_of(normalised).rms,
    )


def judged_points(maps: Maps, truth: Truth) -> Bool[np.ndarray, "rows cols"]:
    """Return the judged pixels that have a point."""
    return maps.valid() & truth.judged & np.isfinite(maps.point_mm).all(axis=2)
