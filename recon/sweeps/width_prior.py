"""What the neighbours and the map's gradient tell of a pixel's footprint before its own curve is fitted.

The gradient gives the two boxes of a square pixel (``footprint.py``); lens and display add a blur that is much the same all over.
How much wider than that the curves of a neighbourhood are is averaged over it, and the scatter tells how far a pixel may
differ. A pixel whose curve fixes its width takes it from the curve; one that was lit in a single photo takes it from here.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int

from recon.compiled import compiled
from recon.sweeps.curve_table import shape_of
from recon.sweeps.stripe_fit import StripeFit, WidthPrior

# The logarithm of the gradient's own width is no better than this, nor is that of the blur, of which the ladder that it is
# chosen from has few steps. Over an even stretch of the map the gradient is right to a hundredth or two; what is left is the
# pixel's own shape. Beside its neighbours a pixel is known no better than to a share of that.
GRADIENT_SD, EVEN_SD, BLUR_SD = (np.float32(sd) for sd in (0.15, 0.05, 0.15))
NEIGHBOUR_SHARE = 2 / 3
WINDOW_PX = 15
WORST_CHI_SQUARE = 9.0


@dataclass(frozen=True, slots=True, eq=False)
class Footprints:
    """Boxes [pixels, 2] from the map's gradient and the sd of the blur common to all pixels, in device pixels.

    ``box_sd`` is the sd of the logarithm of the boxes' widths.
    """

    box_px: Float64[np.ndarray, "pixels 2"] | Float32[np.ndarray, "pixels 2"]
    box_sd: Float32[np.ndarray, " pixels"]
    blur_px: float

    def some(self, pixels: np.ndarray | slice) -> "Footprints":
        """Return the footprints of some of the pixels."""
        return Footprints(self.box_px[pixels], self.box_sd[pixels], self.blur_px)

    def predicted(self) -> tuple[Float64[np.ndarray, " pixels"], Float64[np.ndarray, " pixels"]]:
        """Return the logarithm of the total standard deviation, and that one's own: blur counts by its share of the variance."""
        variance = np.empty(len(self.box_px))
        write_variances(self.box_px, self.blur_px**2, variance)
        blurred = self.blur_px**2 / variance
        return 0.5 * np.log(variance), np.hypot((1 - blurred) * self.box_sd, BLUR_SD * blurred)


@compiled
def write_variances(box_px: np.ndarray, blur_variance: float, variance: np.ndarray) -> None:
    """Write the variances of two boxes each [pixels, 2] and a blur together."""
    for pixel in range(np.uintp(len(variance))):
        by_col, by_row = np.float64(box_px[pixel, 0]), np.float64(box_px[pixel, 1])
        variance[pixel] = (by_col * by_col + by_row * by_row) / 12 + blur_variance


def known_prior(footprints: Footprints, *, sd: float | None = None) -> WidthPrior:
    """Return the prior of footprints whose widths are known to a relative ``sd``, by default as well as they say themselves."""
    log_width, own_sd = footprints.predicted()
    known_sd = own_sd if sd is None else np.full(len(log_width), sd)
    return WidthPrior(shape_of(footprints.box_px, np.exp(log_width)), log_width, known_sd)


@dataclass(frozen=True, slots=True, eq=False)
class NeighbourWidths:
    """How much wider than their boxes and the common blur the footprints of a neighbourhood are, by the logarithm.

    ``pull`` is the sum of what its pixels say times their weights, ``weight`` that of these, ``scatter`` that of the squares of
    what they differ by times their weights. They stand on every ``spacing``-th row and column of the grid, whose pixels are
    ``columns`` a row.
    """

    pull: Float64[np.ndarray, "lattice_rows lattice_cols"]
    weight: Float64[np.ndarray, "lattice_rows lattice_cols"]
    scatter: Float64[np.ndarray, "lattice_rows lattice_cols"]
    spacing: int
    columns: int

    def prior(self, footprints: Footprints, pixels: Int[np.ndarray, " pixels"]) -> WidthPrior:
        """Return the prior of the listed pixels, whose footprints these are."""
        log_width, sd = footprints.predicted()
        # The window about a pixel holds the same pixels of the lattice as that about the nearest one of these.
        nearest = (np.arange(self.columns) + self.spacing // 2) // self.spacing
        write_neighbours(pixels, nearest, self.spacing, self.pull, self.weight, self.scatter, log_width, sd)
        return WidthPrior(shape_of(footprints.box_px, np.exp(log_width)), log_width, sd)


@compiled
def write_neighbours(
    pixels: np.ndarray,
    nearest: np.ndarray,
    spacing: int,
    pull: np.ndarray,
    weight: np.ndarray,
    scatter: np.ndarray,
    log_width: np.ndarray,
    sd: np.ndarray,
) -> None:
    """Add to each listed pixel's width how much wider those of its neighbourhood are, and make of its own sd that beside these.

    ``nearest`` [columns] are the columns of the lattice nearest to those of the photo.
    """
    columns = len(nearest)
    start, row = 0, 0
    for number in range(np.uintp(len(pixels))):
        pixel = pixels[number]
        # Pixels come in order: their row is seldom another than that of the one before.
        if pixel < start or pixel >= start + columns:
            start = pixel // columns * columns
            row = (pixel // columns + spacing // 2) // spacing
        col = nearest[np.uintp(pixel - start)]
        own = sd[number] * sd[number]
        known = weight[row, col] + 1 / own
        log_width[number] += pull[row, col] / known
        sd[number] = np.sqrt(NEIGHBOUR_SHARE**2 * own + (scatter[row, col] + 1) / known)


def neighbour_widths(
    fit: StripeFit,
    footprints: Footprints,
    pixels: Int[np.ndarray, " pixels"],
    *,
    grid: tuple[int, int],
    spacing: int,
) -> NeighbourWidths:
    """Sum up over each neighbourhood how much wider than their ``footprints`` the fitted curves of a lattice of pixels are."""
    predicted, predicted_sd = footprints.predicted()
    wider, own = fit.log_width - predicted, 1 / np.maximum(fit.width_information, 1e-9)
    sound = fit.chi_square < WORST_CHI_SQUARE * fit.freedom
    weight = np.where(sound, 1 / (own + (NEIGHBOUR_SHARE * predicted_sd) ** 2), 0.0)
    row, col = (one // spacing for one in np.divmod(pixels, grid[1]))
    window = (WINDOW_PX // spacing, WINDOW_PX // spacing)

    def summed(values: np.ndarray) -> np.ndarray:
        lattice = np.zeros((grid[0] // spacing + 1, grid[1] // spacing + 1))
        lattice[row, col] = values
        return cv2.boxFilter(lattice, cv2.CV_64F, window, normalize=False, borderType=cv2.BORDER_CONSTANT)

    pull, total = summed(weight * wider), np.maximum(summed(weight), 0.0)
    mean = pull[row, col] / (total[row, col] + predicted_sd**-2)
    scatter = np.maximum(summed(weight * np.maximum((wider - mean) ** 2 - own, 0.0)), 0.0)
    return NeighbourWidths(pull=pull, weight=total, scatter=scatter, spacing=spacing, columns=grid[1])
