"""A few pixels' own intensity curves for the report: the samples about the peak and what was made of them."""

from collections.abc import Callable

import numpy as np

from recon.metrics import PhotoQuality, SampleCurve
from recon.sessions.manifest import StripePattern
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
    sd_px: np.ndarray | None = None,
    drawn: Callable[[np.ndarray], np.ndarray] | None = None,
) -> tuple[SampleCurve, ...]:
    """Return the curves of a lattice of pixels that have a place.

    The method that fits a curve gives the sd of the places [rows, cols] and says how the curves of some pixels are ``drawn``
    [pixels, samples], in counts above black.
    """
    rows, cols = black.shape
    lattice_rows = np.linspace(0, rows - 1, LATTICE + 2).astype(int)[1:-1]
    lattice_cols = np.linspace(0, cols - 1, LATTICE + 2).astype(int)[1:-1]
    pixels = (lattice_rows[:, None] * cols + lattice_cols).ravel()
    place = place.ravel()
    pixels = np.unique(pixels[np.isfinite(place[pixels])])
    models = [None] * len(pixels) if drawn is None or not len(pixels) else drawn(pixels)
    return tuple(
        _curve(int(pixel), windows, cols, photos, black=black, pattern=pattern, place=place, model=model, sd_px=sd_px)
        for pixel, model in zip(pixels, models, strict=True)
    )


def _curve(
    pixel: int,
    windows: PeakWindows,
    cols: int,
    photos: tuple[PhotoQuality, ...],
    *,
    black: np.ndarray,
    pattern: StripePattern,
    place: np.ndarray,
    model: np.ndarray | None,
    sd_px: np.ndarray | None,
) -> SampleCurve:
    number = windows.peak_index[pixel] + np.arange(-windows.half_width, windows.half_width + 1)
    inside = (number >= 0) & (number < windows.photo_count)
    x = pattern.first_px + pattern.step_px * number[inside].astype(np.float64)
    return SampleCurve(
        row=pixel // cols,
        col=pixel % cols,
        set=photos[0].set,
        axis=photos[0].sweep,
        place_px=tuple(x.tolist()),
        intensity=tuple(windows.samples[pixel][inside].astype(float).tolist()),
        model=() if model is None else tuple((black.ravel()[pixel] + model[inside]).tolist()),
        peak_px=float(place[pixel]),
        sd_px=None if sd_px is None else float(sd_px.ravel()[pixel]),
    )
