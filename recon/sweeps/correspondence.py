"""From the photos of one sweep to a display coordinate a camera pixel, by either method."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from recon.memory import give_back_free_memory
from recon.method import Method
from recon.metrics import PhotoQuality, SampleCurve
from recon.sessions.manifest import Axis, CaptureSet, StripePattern
from recon.sessions.photos import saturation_count
from recon.sessions.session import Session
from recon.status import PixelStatus, is_one_of
from recon.sweeps.black_level import black_level, middle_of, noise_floor, reach_floor
from recon.sweeps.curve_reach import curve_half_width
from recon.sweeps.half_seen import half_seen_of
from recon.sweeps.noise import NoiseModel
from recon.sweeps.photo_stream import SweepPhotos, check_depth, photo_quality
from recon.sweeps.sample_curves import sample_curves
from recon.sweeps.stripe_peak import NO_PEAK, PeakWindows, parabola_offset

if TYPE_CHECKING:
    from recon.sweeps.peak_tracker import PeakTracker

# Sharp profiles are seen in one or two photos; a broad footprint spreads them over some more.
NEIGHBOURS_BEYOND_PROFILE = 3
PIXELS_AT_ONCE = 1 << 15
# What a pixel with a place may be.
KNOWN = (PixelStatus.OK, PixelStatus.TWO_PATHS, PixelStatus.HALF_SEEN)


@dataclass(frozen=True, slots=True, eq=False)
class SweepResult:
    """Where each pixel saw the stripe: ``place_px`` in device pixels with ``sd_px``, NaN unless ``known``.

    Single precision, which decoded sweeps have, rounds a place on a display of 4,096 pixels to 0.0001 px, far below its sd; eight
    sweeps of a large photo are kept at a time.

    A pixel of status TWO_PATHS saw the stripe twice: ``place_px`` is that of the path with more light. ``second_px`` with
    ``second_sd_px`` lists those of the other, one for each such pixel, row by row; None where no pixel did, or the method tells
    no two paths apart.
    """

    place_px: Float[np.ndarray, "rows cols"]
    sd_px: Float32[np.ndarray, "rows cols"]
    status: UInt8[np.ndarray, "rows cols"]
    noise: NoiseModel
    misfit: float  # median of chi-square over degrees of freedom; NaN for the paper's method
    photos: tuple[PhotoQuality, ...]
    curves: tuple[SampleCurve, ...]
    second_px: Float[np.ndarray, " two"] | None = None
    second_sd_px: Float32[np.ndarray, " two"] | None = None

    def known(self) -> Bool[np.ndarray, "rows cols"]:
        """Return the pixels that have a place: those that saw the stripe once, twice, or with less than half of their area."""
        return is_one_of(self.status, KNOWN)


def decode_sweep(
    session: Session,
    capture_set: CaptureSet,
    axis: Axis,
    *,
    method: Method,
    on_photo: Callable[[], None] = lambda: None,
) -> SweepResult:
    """Stream the photos of one sweep, one at a time, and return every pixel's stripe place."""
    # Loads the compiler, which would slow every command.
    from recon.sweeps.peak_tracker import PeakTracker

    pattern = capture_set.sweep(axis).pattern
    assert isinstance(pattern, StripePattern)
    photos = SweepPhotos(session, capture_set, axis)
    # A dark photo may not tell in which steps its counts come.
    clipped = saturation_count(photos.early(middle_of(photos.numbers)))
    black, dark, of_black = black_level(session, capture_set, photos.numbers, photo=photos.early)
    floor = noise_floor(black, dark + of_black)
    half_width = window_half_width(pattern, method)
    if method == "full":
        half_width = curve_half_width(
            photos.early,
            photos.numbers,
            black=black,
            floor=reach_floor(black, dark),
            least=half_width,
        )
    # Two paths are for the fit to tell apart.
    tracker = PeakTracker(floor, half_width=half_width, second=method == "full")
    quality = _stream(session, capture_set, axis, photos, tracker, black=black, clipped=clipped, on_photo=on_photo)
    windows = tracker.finish()
    del tracker, floor
    give_back_free_memory()
    if method == "paper":
        return place_by_parabola(windows, pattern, black=black, dark=dark, photos=quality)
    return place_by_likelihood(
        windows,
        pattern,
        black=black,
        dark=dark,
        clipped=clipped,
        photos=quality,
        continuous=session.manifest.display.continuous,
    )


def window_half_width(pattern: StripePattern, method: Method) -> int:
    """Return how many photos before and after a pixel's brightest one its place is made from, where images are sharp."""
    if method == "paper":
        return 1
    return int(np.ceil(pattern.width_px / pattern.step_px / 2)) + NEIGHBOURS_BEYOND_PROFILE


def _stream(
    session: Session,
    capture_set: CaptureSet,
    axis: Axis,
    photos: SweepPhotos,
    tracker: "PeakTracker",
    *,
    black: np.ndarray,
    clipped: int,
    on_photo: Callable[[], None],
) -> tuple[PhotoQuality, ...]:
    free: np.ndarray | None = None
    quality = []
    for index in photos.numbers:
        counts = photos.take(index, buffer=free)
        check_depth(session, capture_set, axis, index, counts, like=black)
        free = tracker.feed(counts)
        brightest = tracker.brightest()
        quality.append(photo_quality(counts, capture_set, axis, index, brightest=brightest, clipped=clipped))
        on_photo()
    return tuple(quality)


def _status(windows: PeakWindows, shape: tuple[int, int]) -> np.ndarray:
    index = windows.peak_index
    status = np.full(index.size, PixelStatus.OK, dtype=np.uint8)
    status[index == NO_PEAK] = PixelStatus.UNLIT
    status[(index == 0) | (index == windows.photo_count - 1)] = PixelStatus.SWEEP_EDGE
    return status.reshape(shape)


def place_by_parabola(
    windows: PeakWindows,
    pattern: StripePattern,
    *,
    black: np.ndarray,
    dark: float,
    photos: tuple[PhotoQuality, ...],
) -> SweepResult:
    """Return the vertex of the parabola through each pixel's three brightest samples, as the paper does."""
    status = _status(windows, black.shape)
    place = np.full(black.size, np.nan, dtype=np.float32)
    middle = windows.half_width
    for low in range(0, black.size, PIXELS_AT_ONCE):
        part = low + np.flatnonzero(status.ravel()[low : low + PIXELS_AT_ONCE] == PixelStatus.OK)
        before, centre, after = windows.samples[part, middle - 1 : middle + 2].T.astype(np.float64, order="C")
        index = windows.peak_index[part] + parabola_offset(before, centre, after)
        place[part] = pattern.first_px + pattern.step_px * index
    return SweepResult(
        place_px=place.reshape(black.shape),
        sd_px=np.broadcast_to(np.float32(np.nan), black.shape),
        status=status,
        noise=NoiseModel(dark),
        misfit=float("nan"),
        photos=photos,
        curves=sample_curves(windows, black, photos, pattern=pattern, place=place),
    )


def place_by_likelihood(
    windows: PeakWindows,
    pattern: StripePattern,
    *,
    black: np.ndarray,
    dark: float,
    clipped: int,
    photos: tuple[PhotoQuality, ...],
    continuous: bool,
) -> SweepResult:
    """Return the most likely place of the stripe in each pixel's window, with its standard deviation."""
    # Loads the compiler, like the tracker.
    from recon.sweeps.likelihood import places_by_likelihood

    status = _status(windows, black.shape)
    pixels = np.flatnonzero(status == PixelStatus.OK).astype(np.int32)
    places = places_by_likelihood(
        windows,
        pixels,
        pattern,
        black=black,
        dark_variance=dark,
        clipped=clipped,
        continuous=continuous,
    )
    status[(status == PixelStatus.OK) & np.isnan(places.place_px)] = PixelStatus.BAD_FIT
    half = half_seen_of(places.light, pixels, status != PixelStatus.UNLIT) & np.isfinite(places.place_px)
    kept = ~half.ravel()[places.twice]
    second_px, second_sd_px = None, None
    if kept.any():
        twice = places.twice[kept]
        status.ravel()[twice] = PixelStatus.TWO_PATHS
        second_px, second_sd_px = places.second_px[kept], places.second_sd_px[kept].astype(np.float32)
    status[half] = PixelStatus.HALF_SEEN
    return SweepResult(
        place_px=places.place_px,
        sd_px=places.sd_px,
        status=status,
        noise=places.fits.noise,
        misfit=places.misfit,
        photos=photos,
        curves=sample_curves(
            windows,
            black,
            photos,
            pattern=pattern,
            place=places.place_px,
            sd_px=places.sd_px,
            drawn=places.fits.drawn,
        ),
        second_px=second_px,
        second_sd_px=second_sd_px,
    )
