"""From the photos of one sweep to a display coordinate a camera pixel, by either method."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from recon.metrics import PhotoQuality, SampleCurve
from recon.sessions.manifest import Axis, CaptureSet, StripePattern
from recon.sessions.photos import read_grey, saturation_count
from recon.sessions.session import Session
from recon.status import PixelStatus
from recon.sweeps.footprint import coordinate_gradient
from recon.sweeps.noise import NoiseModel, dark_variance, noise_from_residuals
from recon.sweeps.sample_curves import sample_curves
from recon.sweeps.stripe_fit import curve_samples, fit_stripe
from recon.sweeps.stripe_model import expected_curve
from recon.sweeps.stripe_peak import NO_PEAK, PeakTracker, PeakWindows, parabola_offset

Method = Literal["paper", "full"]

# A peak is one that noise alone would show in one dark sample of a thousand million.
PEAK_SIGMA = 6.0
LEAST_PEAK_COUNTS = 2.0
# Sharp profiles are seen in one or two photos; a broad footprint spreads them over some more.
NEIGHBOURS_BEYOND_PROFILE = 3
# A curve whose misfit is a quarter of its height is not that of one stripe.
LARGEST_MISFIT = 0.25
NOISE_SAMPLE_PIXELS = 8000


@dataclass(frozen=True, slots=True, eq=False)
class SweepResult:
    """Where each pixel saw the stripe: ``place_px`` in device pixels with ``sd_px``, NaN unless ``status`` is OK."""

    place_px: Float64[np.ndarray, "rows cols"]
    sd_px: Float32[np.ndarray, "rows cols"]
    status: UInt8[np.ndarray, "rows cols"]
    noise: NoiseModel
    misfit: float  # median of chi-square over degrees of freedom; NaN for the paper's method
    photos: tuple[PhotoQuality, ...]
    curves: tuple[SampleCurve, ...]


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
    windows, photos = _stream(
        session, capture_set, axis, floor=floor, half_width=window_half_width(pattern, method), on_photo=on_photo
    )
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
    """Return how many photos before and after a pixel's brightest one its place is made from."""
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
    brightest_px = pattern.first_px + pattern.step_px * windows.peak_index[pixels].astype(np.float64)
    place = _centroid(windows, pixels, pattern, black=black)
    noise = NoiseModel(dark)
    fit = None
    footprint = np.zeros((len(pixels), 2))
    # The footprint comes from the map's gradient and the map from the fit: twice round is enough.
    for last in (False, True):
        footprint = _footprint(place, pixels, black.shape, quantum_px=2 * pattern.step_px)
        noise = _noise(
            windows,
            pixels,
            place,
            footprint,
            noise=noise,
            black=black,
            pattern=pattern,
            clipped=clipped,
            continuous=continuous,
        )
        fit = fit_stripe(
            windows,
            pixels,
            place,
            footprint,
            black=black.ravel(),
            pattern=pattern,
            noise=noise,
            clipped=clipped,
            continuous=continuous,
            intervals=last,
        )
        place = np.clip(fit.place_px, brightest_px - 2 * pattern.step_px, brightest_px + 2 * pattern.step_px)
    assert fit is not None
    residual_rms = np.sqrt(fit.chi_square / (fit.freedom + 3) * noise.variance(fit.amplitude / 2))
    # A place known no better than the stripe's own width says nothing.
    vague = ~(fit.sd_px < max(pattern.width_px, pattern.step_px))
    bad = (residual_rms > LARGEST_MISFIT * fit.amplitude) | (fit.amplitude <= 0) | vague
    status[pixels[bad]] = PixelStatus.BAD_FIT
    place_map = np.full(black.size, np.nan)
    sd_map = np.full(black.size, np.nan, dtype=np.float32)
    place_map[pixels[~bad]] = fit.place_px[~bad]
    sd_map[pixels[~bad]] = fit.sd_px[~bad]
    return SweepResult(
        place_px=place_map.reshape(black.shape),
        sd_px=sd_map.reshape(black.shape),
        status=status.reshape(black.shape),
        noise=noise,
        misfit=float(np.median(fit.chi_square / fit.freedom)) if len(pixels) else float("nan"),
        photos=photos,
        curves=sample_curves(
            windows,
            black,
            photos,
            pattern=pattern,
            place=place_map,
            fit=(pixels, fit, footprint),
            continuous=continuous,
        ),
    )


def _centroid(windows: PeakWindows, pixels: np.ndarray, pattern: StripePattern, *, black: np.ndarray) -> np.ndarray:
    """Return a first guess in device pixels: the centre of mass of the samples nearest to the brightest."""
    reach = min(2, windows.half_width)
    columns = slice(windows.half_width - reach, windows.half_width + reach + 1)
    height = windows.samples[pixels, columns].astype(np.float64) - black.ravel()[pixels, None]
    height = np.maximum(height, 0.0)
    offset = (height @ np.arange(-reach, reach + 1.0)) / np.maximum(height.sum(axis=1), 1e-9)
    return pattern.first_px + pattern.step_px * (windows.peak_index[pixels] + offset)


def _footprint(place: np.ndarray, pixels: np.ndarray, shape: tuple[int, int], *, quantum_px: float) -> np.ndarray:
    place_map = np.full(shape, np.nan)
    place_map.ravel()[pixels] = place
    gradient = coordinate_gradient(place_map, np.isfinite(place_map), quantum_px=quantum_px)
    widths = np.abs(gradient).reshape(-1, 2)[pixels]
    known = np.isfinite(widths).all(axis=1)
    typical = np.median(widths[known], axis=0) if known.any() else np.array([0.5, 0.5])
    return np.where(known[:, None], widths, typical)


def _noise(
    windows: PeakWindows,
    pixels: np.ndarray,
    place: np.ndarray,
    footprint: np.ndarray,
    *,
    noise: NoiseModel,
    black: np.ndarray,
    pattern: StripePattern,
    clipped: int,
    continuous: bool,
) -> NoiseModel:
    """Fit an even sample of the pixels with the noise known so far and read the noise from what is left."""
    some = np.arange(0, len(pixels), max(-(-len(pixels) // NOISE_SAMPLE_PIXELS), 1))
    if len(some) == 0:
        return noise
    fit = fit_stripe(
        windows,
        pixels[some],
        place[some],
        footprint[some],
        black=black.ravel(),
        pattern=pattern,
        noise=noise,
        clipped=clipped,
        continuous=continuous,
        intervals=False,
    )
    samples = curve_samples(windows, pixels[some], black=black.ravel(), pattern=pattern, clipped=clipped)
    shape, _ = expected_curve(samples.place_px, fit.place_px, footprint[some], pattern=pattern, continuous=continuous)
    model = fit.amplitude[:, None] * shape
    residual = samples.counts - fit.background[:, None] - model
    used = samples.usable
    return noise_from_residuals(
        model[used],
        residual[used],
        read_variance=noise.read_variance,
        freedom_share=float(fit.freedom.mean()) / float(used.sum(axis=1).mean()),
    )
