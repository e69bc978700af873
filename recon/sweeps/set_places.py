"""The two sweeps of a set joined: where each pixel looks on the display, by the path with more light and by the other."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int, UInt8

from recon.patterns.sweep_frames import screen_mm
from recon.sessions.manifest import Axis, CaptureSet, Manifest
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
AXES: tuple[Axis, Axis] = ("x", "y")
# What is made of so many pixels is small beside the maps of a large photo.
PIXELS_AT_ONCE = 1 << 19

SweepResults = Mapping[tuple[str, str], SweepResult]
Pixels = Int[np.ndarray, " pixels"]


@dataclass(frozen=True, slots=True, eq=False)
class Correspondences:
    """Where some pixels look on the display in one set, in screen mm, with its sd; ``doubled`` see the display twice."""

    screen_mm: Float64[np.ndarray, "pixels 2"]
    sd_mm: Float64[np.ndarray, "pixels 2"]
    doubled: Bool[np.ndarray, " pixels"]

    def with_rows_of(self, other: "Correspondences", rows: Int[np.ndarray, " some"]) -> "Correspondences":
        """Return these with all places of other ones in some rows."""
        screen, sd = self.screen_mm.copy(), self.sd_mm.copy()
        screen[rows], sd[rows] = other.screen_mm, other.sd_mm
        return Correspondences(screen, sd, self.doubled)


def correspondences(
    sweeps: SweepResults, capture_set: CaptureSet, manifest: Manifest, pixels: Pixels
) -> Correspondences:
    """Join the sweeps along x and y of one set at ``pixels``, which number the photo row by row."""
    each = {axis: sweeps[capture_set.name, axis] for axis in AXES}
    places = {axis: one.place_px.ravel()[pixels] for axis, one in each.items()}
    sds = {axis: one.sd_px.ravel()[pixels] for axis, one in each.items()}
    return _joined(each, places, sds, manifest, pixels)


def second_correspondences(
    sweeps: SweepResults, capture_set: CaptureSet, manifest: Manifest, pixels: Pixels
) -> Correspondences:
    """Join the sweeps of one set where pixels see the display twice, by the path with less light.

    A sweep in which both paths have the same place has one peak, which belongs to both.
    """
    each = {axis: sweeps[capture_set.name, axis] for axis in AXES}
    lesser = {axis: _lesser(one, pixels) for axis, one in each.items()}
    places, sds = ({axis: one[number] for axis, one in lesser.items()} for number in (0, 1))
    return _joined(each, places, sds, manifest, pixels)


def _joined(
    sweeps: Mapping[Axis, SweepResult],
    place_px: Mapping[Axis, np.ndarray],
    sd_px: Mapping[Axis, np.ndarray],
    manifest: Manifest,
    pixels: Pixels,
) -> Correspondences:
    display = manifest.display
    return Correspondences(
        screen_mm=np.stack([screen_mm(place_px[axis].astype(np.float64), axis, display) for axis in AXES], axis=1),
        sd_mm=np.stack([sd_px[axis] for axis in AXES], axis=1).astype(np.float64) * display.pitch_mm,
        doubled=np.any([sweeps[axis].status.ravel()[pixels] == PixelStatus.TWO_PATHS for axis in AXES], axis=0),
    )


def _lesser(sweep: SweepResult, pixels: Pixels) -> tuple[np.ndarray, np.ndarray]:
    """Return places and sds of the path with less light at these pixels, of the only one where there is one."""
    place_px, sd_px = sweep.place_px.ravel()[pixels], sweep.sd_px.ravel()[pixels]
    if sweep.second_px is None or sweep.second_sd_px is None:
        return place_px, sd_px
    two = sweep.status.ravel()[pixels] == PixelStatus.TWO_PATHS
    row = np.searchsorted(np.flatnonzero(sweep.status == PixelStatus.TWO_PATHS), pixels[two])
    place_px[two], sd_px[two] = sweep.second_px[row], sweep.second_sd_px[row]
    return place_px, sd_px


def combined_status(sweeps: SweepResults, sets: Sequence[CaptureSet]) -> UInt8[np.ndarray, " pixels"]:
    """Return OK where every one of the sets has one correspondence, and otherwise the reason that explains most."""
    by_set = [[sweeps[one.name, axis].status.ravel() for axis in AXES] for one in sets]
    status = np.empty(by_set[0][0].size, dtype=np.uint8)
    for low in range(0, len(status), PIXELS_AT_ONCE):
        part = slice(low, low + PIXELS_AT_ONCE)
        status[part] = _combined([_agreed(np.stack([x[part], y[part]])) for x, y in by_set])
    return status


def _combined(by_set: Iterable[UInt8[np.ndarray, "2 pixels"]]) -> UInt8[np.ndarray, " pixels"]:
    every = np.concatenate(list(by_set))
    unlit = every == PixelStatus.UNLIT
    status = np.full(every.shape[1], PixelStatus.OK, dtype=np.uint8)
    for reason in SWEEP_REASONS:
        status[(every == reason).any(axis=0)] = reason
    status[unlit.any(axis=0)] = PixelStatus.PARTLY_LIT
    status[unlit.all(axis=0)] = PixelStatus.UNLIT
    return status


def _agreed(status: UInt8[np.ndarray, "2 pixels"]) -> UInt8[np.ndarray, "2 pixels"]:
    """Take a pixel for half seen where both sweeps of the set say so: they measure the same light."""
    half = status == PixelStatus.HALF_SEEN
    return np.where(half & ~half.all(axis=0), np.uint8(PixelStatus.OK), status)


def path_count(sweeps: SweepResults) -> UInt8[np.ndarray, "rows cols"]:
    """Return by how many light paths each pixel sees the display, as far as any sweep tells: 0, 1 or 2."""
    count: np.ndarray | None = None
    for one in sweeps.values():
        lit = (one.status != PixelStatus.UNLIT).astype(np.uint8)
        lit[one.status == PixelStatus.TWO_PATHS] = 2
        count = lit if count is None else np.maximum(count, lit, out=count)
    assert count is not None, "a session has sweeps"
    return count
