"""From the photos of one sweep to a display coordinate a camera pixel, by either method."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from recon.metrics import PhotoQuality, SampleCurve
from recon.sessions.manifest import Axis, CaptureSet, StripePattern
from recon.sessions.photos import read_grey, saturation_count
from recon.sessions.session import Session
from recon.status import PixelStatus
from recon.sweeps.curve_reach import curve_half_width
from recon.sweeps.half_seen import less_than_half_seen
from recon.sweeps.likelihood import places_by_likelihood
from recon.sweeps.noise import NoiseModel, dark_variance
from recon.sweeps.sample_curves import sample_curves
from recon.sweeps.stripe_peak import NO_PEAK, PeakTracker, PeakWindows, parabola_offset

Method = Literal["paper", "full"]

# A peak is one that noise alone would show in one dark sample of a thousand million.
PEAK_SIGMA = 6.0
LEAST_PEAK_COUNTS = 2.0
# Sharp profiles are seen in one or two photos; a broad footprint spreads them over some more.
NEIGHBOURS_BEYOND_PROFILE = 3


@dataclass(frozen=True, slots=True, eq=False)
class SweepResult:
    """Where each pixel saw the stripe: ``place_px`` in device pixels with ``sd_px``, NaN unless ``known``.

    A pixel of status TWO_PATHS saw it twice: ``place_px`` is that of the path with more light, ``second_px`` with
    ``second_sd_px`` that of the other, NaN for all other pixels; None where the pattern or the method tells no two paths apart.
    """

    place_px: Float64[np.ndarray, "rows cols"]
    sd_px: Float32[np.ndarray, "rows cols"]
    status: UInt8[np.ndarray, "rows cols"]
    noise: NoiseModel
    misfit: float  # median of chi-square over degrees of freedom; NaN for the paper's method
    photos: tuple[PhotoQuality, ...]
    curves: tuple[SampleCurve, ...]
    second_px: Float64[np.ndarray, "rows cols"] | None = None
    second_sd_px: Float32[np.ndarray, "rows cols"] | None = None

    def known(self) -> Bool[np.ndarray, "rows cols"]:
        """Return the pixels that have a place: those that saw the stripe once, twice, or with less than half of their area."""
        return np.isin(self.status, (PixelStatus.OK, PixelStatus.TWO_PATHS, PixelStatus.HALF_SEEN))


def decode_sweep(
    session: Session,
    capture_set: CaptureSet,
    axis: Axis,
    *,
    method: Method,
    on_photo: Callable[[], None] = lambda: None,
) -> SweepResult:
    """Stream the photos of one sweep, one at a time, and return every pixel's stripe place."""
    pattern = capture_set.sweep(axis).pattern
    assert isinstance(pattern, StripePattern)
    black, dark = _black_level(session, capture_set, axis)
    rise = max(PEAK_SIGMA * np.sqrt(dark), LEAST_PEAK_COUNTS)
    floor = np.minimum(black + rise, np.iinfo(black.dtype).max).astype(black.dtype)
    half_width = window_half_width(pattern, method)
    if method == "full":
        half_width = curve_half_width(
            lambda number: read_session_photo(session, capture_set.name, axis, number),
            session.photo_numbers(capture_set, axis),
            black=black,
            floor=floor,
            least=half_width,
        )
    windows, photos = _stream(session, capture_set, axis, floor=floor, half_width=half_width, on_photo=on_photo)
    clipped = saturation_count(black)
    if method == "paper":
        return place_by_parabola(windows, pattern, black=black, dark=dark, photos=photos)
    return place_by_likelihood(
        windows,
        pattern,
        black=black,
        dark=dark,
        clipped=clipped,
        photos=photos,
        continuous=session.manifest.display.continuous,
    )


def window_half_width(pattern: StripePattern, method: Method) -> int:
    """Return how many photos before and after a pixel's brightest one its place is made from, where images are sharp."""
    if method == "paper":
        return 1
    return int(np.ceil(pattern.width_px / pattern.step_px / 2)) + NEIGHBOURS_BEYOND_PROFILE


def _black_level(session: Session, capture_set: CaptureSet, axis: Axis) -> tuple[np.ndarray, float]:
    """Return the counts without the stripe and the variance of one dark sample.

    The black photo where there is one; otherwise the median of five photos spread over the sweep.
    """
    numbers = session.photo_numbers(capture_set, axis)

    def photo(sweep: str, index: int) -> np.ndarray:
        return read_session_photo(session, capture_set.name, sweep, index)

    first, last = photo(axis, numbers[0]), photo(axis, numbers[-1])
    variance = dark_variance(first, last)
    if (capture_set.name, "black", 0) in session.photos:
        return photo("black", 0), variance
    spread = [photo(axis, numbers[round(share * (len(numbers) - 1))]) for share in (0.0, 0.25, 0.5, 0.75, 1.0)]
    return np.median(np.stack(spread), axis=0).astype(first.dtype), variance


def read_session_photo(
    session: Session, set_name: str, sweep: str, index: int, *, buffer: np.ndarray | None = None
) -> np.ndarray:
    """Return one photo of a session as grey counts [rows, cols]."""
    camera = session.manifest.camera
    return read_grey(
        session.photo_file(set_name, sweep, index),
        rows=camera.rows,
        cols=camera.columns,
        primary=session.manifest.display.primary,
        buffer=buffer,
    )


def _stream(
    session: Session,
    capture_set: CaptureSet,
    axis: Axis,
    *,
    floor: np.ndarray,
    half_width: int,
    on_photo: Callable[[], None],
) -> tuple[PeakWindows, tuple[PhotoQuality, ...]]:
    tracker = PeakTracker(floor, half_width=half_width)
    clipped = saturation_count(floor)
    free: np.ndarray | None = None
    quality = []
    for index in session.photo_numbers(capture_set, axis):
        counts = read_session_photo(session, capture_set.name, axis, index, buffer=free)
        brightest = int(counts.max())
        share = float((counts >= clipped).mean()) if brightest >= clipped else 0.0
        quality.append(
            PhotoQuality(set=capture_set.name, sweep=axis, index=index, brightest=brightest, saturated_share=share)
        )
        free = tracker.feed(counts)
        on_photo()
    return tracker.finish(), tuple(quality)


def _status(windows: PeakWindows, shape: tuple[int, int]) -> np.ndarray:
    status = np.full(windows.peak_index.size, PixelStatus.OK, dtype=np.uint8)
    status[windows.peak_index == NO_PEAK] = PixelStatus.UNLIT
    edge = (windows.peak_index == 0) | (windows.peak_index == windows.photo_count - 1)
    status[edge] = PixelStatus.SWEEP_EDGE
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
    middle = windows.half_width
    before, centre, after = (windows.samples[:, middle + k].astype(np.float64) for k in (-1, 0, 1))
    index = windows.peak_index + parabola_offset(before, centre, after)
    place = np.where(status.ravel() == PixelStatus.OK, pattern.first_px + pattern.step_px * index, np.nan)
    return SweepResult(
        place_px=place.reshape(black.shape),
        sd_px=np.full(black.shape, np.nan, dtype=np.float32),
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
    status = _status(windows, black.shape).ravel()
    pixels = np.flatnonzero(status == PixelStatus.OK)
    places = places_by_likelihood(
        windows, pixels, pattern, black=black, dark_variance=dark, clipped=clipped, continuous=continuous
    )
    good, fit = places.good, places.fit
    status[pixels[~good]] = PixelStatus.BAD_FIT
    place_map = np.full(black.size, np.nan)
    sd_map = np.full(black.size, np.nan, dtype=np.float32)
    place_map[pixels[good]] = fit.place_px[good]
    sd_map[pixels[good]] = fit.sd_px[good]
    light = np.full(black.size, np.nan)
    light[pixels] = fit.amplitude
    lit = (status != PixelStatus.UNLIT).reshape(black.shape)
    half = less_than_half_seen(light.reshape(black.shape), lit).ravel() & np.isfinite(place_map)
    two = places.two.some(~half[pixels[places.two.rows]])
    second_map, second_sd_map = np.full(black.size, np.nan), np.full(black.size, np.nan, dtype=np.float32)
    second_map[pixels[two.rows]], second_sd_map[pixels[two.rows]] = two.second.place_px, two.second.sd_px
    status[pixels[two.rows]] = PixelStatus.TWO_PATHS
    status[half] = PixelStatus.HALF_SEEN
    return SweepResult(
        place_px=place_map.reshape(black.shape),
        sd_px=sd_map.reshape(black.shape),
        status=status.reshape(black.shape),
        noise=places.noise,
        misfit=float(np.median(fit.chi_square / fit.freedom)) if len(pixels) else float("nan"),
        photos=photos,
        curves=sample_curves(windows, black, photos, pattern=pattern, place=place_map, fit=places),
        second_px=second_map.reshape(black.shape),
        second_sd_px=second_sd_map.reshape(black.shape),
    )
