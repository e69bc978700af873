"""A few pixels' own intensity curves for the report: the samples about the peak and what was made of them."""

import numpy as np

from recon.metrics import PhotoQuality, SampleCurve
from recon.sessions.manifest import StripePattern
from recon.sweeps.stripe_fit import StripeFit
from recon.sweeps.stripe_model import expected_curve
from recon.sweeps.stripe_peak import PeakWindows

# An even lattice of candidates; the report draws some of those that became points.
LATTICE = 12


def sample_curves(
    windows: PeakWindows,
    black: np.ndarray,
    photos: tuple[PhotoQuality, ...],
    *,
    pattern: StripePattern,
    place: np.ndarray,
    fit: tuple[np.ndarray, StripeFit, np.ndarray] | None = None,
    continuous: bool = False,
) -> tuple[SampleCurve, ...]:
    """Return the curves of a lattice of pixels that have a place.

    ``fit`` is (the fitted pixels in ascending order, their fit, their footprints) for the method that fits a curve.
    """
    rows, cols = black.shape
    lattice_rows = np.linspace(0, rows - 1, LATTICE + 2).astype(int)[1:-1]
    lattice_cols = np.linspace(0, cols - 1, LATTICE + 2).astype(int)[1:-1]
    pixels = (lattice_rows[:, None] * cols + lattice_cols).ravel()
    place = place.ravel()
    return tuple(
        _curve(
            int(pixel),
            windows,
            cols,
            photos,
            pattern=pattern,
            place_px=float(place[pixel]),
            fit=fit,
            continuous=continuous,
        )
        for pixel in np.unique(pixels)
        if np.isfinite(place[pixel])
    )


def _curve(
    pixel: int,
    windows: PeakWindows,
    cols: int,
    photos: tuple[PhotoQuality, ...],
    *,
    pattern: StripePattern,
    place_px: float,
    fit: tuple[np.ndarray, StripeFit, np.ndarray] | None,
    continuous: bool,
) -> SampleCurve:
    number = windows.peak_index[pixel] + np.arange(-windows.half_width, windows.half_width + 1)
    inside = (number >= 0) & (number < windows.photo_count)
    x = pattern.first_px + pattern.step_px * number[inside].astype(np.float64)
    model: tuple[float, ...] = ()
    sd_px = None
    if fit is not None:
        fitted_pixels, values, footprint = fit
        row = int(np.searchsorted(fitted_pixels, pixel))
        shape, _ = expected_curve(
            x[None, :], np.array([place_px]), footprint[row : row + 1], pattern=pattern, continuous=continuous
        )
        model = tuple((values.background[row] + values.amplitude[row] * shape[0]).tolist())
        sd_px = float(values.sd_px[row])
    return SampleCurve(
        row=pixel // cols,
        col=pixel % cols,
        set=photos[0].set,
        axis=photos[0].sweep,
        place_px=tuple(x.tolist()),
        intensity=tuple(windows.samples[pixel][inside].astype(float).tolist()),
        model=model,
        peak_px=place_px,
        sd_px=sd_px,
    )
