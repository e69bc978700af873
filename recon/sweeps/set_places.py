"""The two sweeps of a set joined: where each pixel looks on the display, by the path with more light and by the other."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from recon.patterns.sweep_frames import screen_mm
from recon.sessions.manifest import CaptureSet, Manifest
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult

# Why a sweep has no place, or not one alone; what comes later explains more.
SWEEP_REASONS = (
    PixelStatus.TWO_PATHS,
    PixelStatus.HALF_SEEN,
    PixelStatus.BAD_CODE,
    PixelStatus.BAD_FIT,
    PixelStatus.SWEEP_EDGE,
)

SweepResults = Mapping[tuple[str, str], SweepResult]


@dataclass(frozen=True, slots=True, eq=False)
class Correspondences:
    """Where each pixel [pixels = rows * cols] looks on the display in one set, in screen mm, with its sd."""

    screen_mm: Float64[np.ndarray, "pixels 2"]
    sd_mm: Float64[np.ndarray, "pixels 2"]
    status: UInt8[np.ndarray, "pixels 2"]

    def doubled(self) -> Bool[np.ndarray, " pixels"]:
        """Return which pixels see the display twice in this set."""
        return (self.status == PixelStatus.TWO_PATHS).any(axis=1)

    def with_places_of(self, other: "Correspondences", pixels: np.ndarray) -> "Correspondences":
        """Return these with the places of other ones at some pixels."""
        screen, sd = self.screen_mm.copy(), self.sd_mm.copy()
        screen[pixels], sd[pixels] = other.screen_mm[pixels], other.sd_mm[pixels]
        return Correspondences(screen, sd, self.status)


def correspondences(sweeps: SweepResults, capture_set: CaptureSet, manifest: Manifest) -> Correspondences:
    """Join the sweeps along x and y of one set."""
    x, y = sweeps[capture_set.name, "x"], sweeps[capture_set.name, "y"]
    pitch = manifest.display.pitch_mm
    return Correspondences(
        screen_mm=np.stack(
            [
                screen_mm(x.place_px.ravel(), "x", manifest.display),
                screen_mm(y.place_px.ravel(), "y", manifest.display),
            ],
            axis=1,
        ),
        sd_mm=np.stack([x.sd_px.ravel(), y.sd_px.ravel()], axis=1).astype(np.float64) * pitch,
        status=np.stack([x.status.ravel(), y.status.ravel()], axis=1),
    )


def combined_status(sets: list[Correspondences]) -> UInt8[np.ndarray, " pixels"]:
    """Return OK where every set has one correspondence, and otherwise the reason that explains most."""
    every = np.concatenate([_agreed(one.status) for one in sets], axis=1)
    unlit = every == PixelStatus.UNLIT
    status = np.full(len(every), PixelStatus.OK, dtype=np.uint8)
    for reason in SWEEP_REASONS:
        status[(every == reason).any(axis=1)] = reason
    status[unlit.any(axis=1)] = PixelStatus.PARTLY_LIT
    status[unlit.all(axis=1)] = PixelStatus.UNLIT
    return status


def _agreed(status: UInt8[np.ndarray, "pixels 2"]) -> UInt8[np.ndarray, "pixels 2"]:
    """Take a pixel for half seen where both sweeps of the set say so: they measure the same light."""
    half = status == PixelStatus.HALF_SEEN
    return np.where(half & ~half.all(axis=1, keepdims=True), np.uint8(PixelStatus.OK), status)


def second_correspondences(sweeps: SweepResults, capture_set: CaptureSet, manifest: Manifest) -> Correspondences:
    """Join the sweeps of one set where pixels see the display twice, by the path with less light.

    A sweep in which both paths have the same place has one peak, which belongs to both.
    """
    lesser = {(capture_set.name, axis): _lesser(sweeps[capture_set.name, axis]) for axis in ("x", "y")}
    return correspondences(lesser, capture_set, manifest)


def _lesser(sweep: SweepResult) -> SweepResult:
    if sweep.second_px is None or sweep.second_sd_px is None:
        return sweep
    two = sweep.status == PixelStatus.TWO_PATHS
    return replace(
        sweep,
        place_px=np.where(two, sweep.second_px, sweep.place_px),
        sd_px=np.where(two, sweep.second_sd_px, sweep.sd_px),
    )


def path_count(sweeps: SweepResults) -> UInt8[np.ndarray, "rows cols"]:
    """Return by how many light paths each pixel sees the display, as far as any sweep tells: 0, 1 or 2."""
    each = list(sweeps.values())
    two = np.any([one.status == PixelStatus.TWO_PATHS for one in each], axis=0)
    lit = np.any([one.status != PixelStatus.UNLIT for one in each], axis=0)
    return np.where(two, 2, lit).astype(np.uint8)
