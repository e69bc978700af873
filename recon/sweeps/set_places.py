"""The two sweeps of a set joined: where each pixel looks on the display, by the path with more light and by the other."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int, UInt8

from recon.compiled import compiled
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
# Compiled loops know numbers alone.
OK, UNLIT, TWO_PATHS, PARTLY_LIT = (
    np.uint8(getattr(PixelStatus, name)) for name in ("OK", "UNLIT", "TWO_PATHS", "PARTLY_LIT")
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
    every = [sweeps[one.name, axis].status.ravel() for one in sets for axis in AXES]
    rank = np.zeros(256, np.int64)
    rank[list(SWEEP_REASONS)] = np.arange(1, len(SWEEP_REASONS) + 1)
    status = np.empty(every[0].size, dtype=np.uint8)
    for low in range(0, len(status), PIXELS_AT_ONCE):
        part = slice(low, low + PIXELS_AT_ONCE)
        each = np.stack([one[part] for one in every])
        # Mostly the dark is the larger part of a photo.
        lit = np.flatnonzero((each != UNLIT).any(axis=0))
        found = np.empty(len(lit), dtype=np.uint8)
        _combine(np.take(each, lit, axis=1), rank, found)
        status[part] = UNLIT
        status[part][lit] = found
    return status


@compiled
def _combine(every: np.ndarray, rank: np.ndarray, status: np.ndarray) -> None:
    """Write what the sweeps of all sets say together; a higher ``rank`` explains more, 0 nothing."""
    for pixel in range(len(status)):
        most, reason, unlit = 0, OK, 0
        for sweep in range(len(every)):
            one = every[sweep, pixel]
            unlit += one == UNLIT
            if rank[one] > most:
                most, reason = rank[one], one
        if unlit > 0:
            reason = UNLIT if unlit == len(every) else PARTLY_LIT
        status[pixel] = reason


def path_count(sweeps: SweepResults) -> UInt8[np.ndarray, "rows cols"]:
    """Return by how many light paths each pixel sees the display, as far as any sweep tells: 0, 1 or 2."""
    every = [one.status for one in sweeps.values()]
    lit, twice = np.zeros(every[0].shape, dtype=bool), np.zeros(every[0].shape, dtype=bool)
    for status in every:
        lit |= status != UNLIT
        twice |= status == TWO_PATHS
    return lit.view(np.uint8) + twice.view(np.uint8)
