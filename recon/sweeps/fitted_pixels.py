"""What is kept of the fits of a sweep's pixels: maps of the places, and lists of what is needed for the lit pixels alone."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int

from recon.compiled import compiled
from recon.sweeps.curve_fits import CurveFits
from recon.sweeps.stripe_fit import StripeFit

# The median misfit of so many curves is that of all.
MISFIT_PIXELS = 1 << 20
LAID_AT_ONCE = 1 << 16


@dataclass(frozen=True, slots=True, eq=False)
class FittedPixels:
    """Maps of places and sds in device pixels, NaN where there is no good fit, and lists of what else was fitted.

    ``misfit`` is chi-square over ``freedom``. Lists are in the order of the fits' pixels, often a small part of the photo.
    """

    fits: CurveFits
    place_px: Float32[np.ndarray, "rows cols"]
    sd_px: Float32[np.ndarray, "rows cols"]
    misfit: Float32[np.ndarray, " pixels"]
    freedom: Float32[np.ndarray, " pixels"]
    width_px: Float32[np.ndarray, " pixels"]
    light: Float32[np.ndarray, " pixels"]

    def keep(self, rows: np.ndarray | slice, fit: StripeFit, good: np.ndarray) -> None:
        """Keep the fits of some rows of the list, and the places of the good ones."""
        self.misfit[rows] = fit.chi_square / fit.freedom
        self.freedom[rows], self.light[rows] = fit.freedom, fit.amplitude
        self.width_px[rows] = np.exp(fit.log_width)
        write_good(self.fits.pixels[rows], good, fit.place_px, fit.sd_px, self.place_px.ravel(), self.sd_px.ravel())

    def usual_misfit(self) -> float:
        """Return the median misfit; NaN where nothing was fitted."""
        few = self.misfit[:: max(len(self.misfit) // MISFIT_PIXELS, 1)]
        return float(np.median(few)) if len(few) else float("nan")


@compiled
def write_good(
    pixels: np.ndarray,
    good: np.ndarray,
    place_px: np.ndarray,
    sd_px: np.ndarray,
    place_map: np.ndarray,
    sd_map: np.ndarray,
) -> None:
    """Write places and sds of the good ones of some pixels into the maps."""
    for number in range(np.uintp(len(pixels))):
        if good[number]:
            pixel = np.uintp(pixels[number])
            place_map[pixel], sd_map[pixel] = place_px[number], sd_px[number]


def laid(
    values: Float32[np.ndarray, " pixels"], pixels: Int[np.ndarray, " pixels"], band: slice, *, columns: int
) -> Float32[np.ndarray, "rows cols"]:
    """Return a band of rows of the photo with the values of the listed pixels in their places, else NaN."""
    laid = np.full((band.stop - band.start) * columns, np.nan, dtype=np.float32)
    # Numbers of another type would have all the pixels converted.
    ends = np.array([band.start * columns, band.stop * columns], dtype=pixels.dtype)
    first, last = np.searchsorted(pixels, ends)
    for low in range(first, last, LAID_AT_ONCE):
        rows = slice(low, min(low + LAID_AT_ONCE, last))
        laid[pixels[rows] - band.start * columns] = values[rows]
    return laid.reshape(-1, columns)


@dataclass(frozen=True, slots=True, eq=False)
class SecondPaths:
    """The pixels that the stripe lit twice, in ascending order: place, sd and width in px of the path with less light."""

    pixels: Int[np.ndarray, " twice"]
    place_px: Float64[np.ndarray, " twice"]
    sd_px: Float64[np.ndarray, " twice"]
    width_px: Float64[np.ndarray, " twice"]


def nothing_fitted(fits: CurveFits, grid: tuple[int, int]) -> FittedPixels:
    """Return the lists and maps of a photo of ``grid`` rows and columns, to be filled."""
    place_px, sd_px = (np.full(grid, np.nan, dtype=np.float32) for _ in range(2))
    return FittedPixels(fits, place_px, sd_px, *(np.empty(len(fits.pixels), dtype=np.float32) for _ in range(4)))


def keep_second_paths(fitted: FittedPixels, rows: Int[np.ndarray, " some"], *, at_once: int) -> SecondPaths:
    """Fit two paths to the listed pixels that may have been lit twice, keep the brighter ones and return the others."""
    fits = fitted.fits
    found = [SecondPaths(fits.pixels[:0], *(np.empty(0) for _ in range(3)))]
    for low in range(0, len(rows), at_once):
        two = fits.fit_two(rows[low : low + at_once])
        # The other peak may reach into the window's end, and its light has been taken away: no curve is cut off.
        fitted.keep(two.rows, two.first, np.ones(len(two.rows), dtype=bool))
        second = two.second
        sd_px = second.sd_px * np.sqrt(np.maximum(second.chi_square / second.freedom, 1.0))
        found.append(SecondPaths(fits.pixels[two.rows], second.place_px, sd_px, np.exp(second.log_width)))
    return SecondPaths(*(np.concatenate([getattr(one, name) for one in found]) for name in SecondPaths.__slots__))
