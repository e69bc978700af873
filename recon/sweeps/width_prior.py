"""What the neighbours and the map's gradient tell of a pixel's footprint before its own curve is fitted.

The gradient gives the two boxes of a square pixel (``footprint.py``); lens and display add a blur that is much the same all over.
How much wider than that the curves of a neighbourhood are is averaged over it, and the scatter tells how far a pixel may
differ. A pixel whose curve fixes its width takes it from the curve; one that was lit in a single photo takes it from here.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64

from recon.sweeps.curve_table import shape_of
from recon.sweeps.stripe_fit import StripeFit, WidthPrior

# The logarithm of the gradient's own width is no better than this, and neighbours differ by at least so much.
GRADIENT_SD = 0.15
NEIGHBOUR_SD = 0.1
WINDOW_PX = 15
WORST_CHI_SQUARE = 9.0


@dataclass(frozen=True, slots=True, eq=False)
class Footprints:
    """Boxes [pixels, 2] from the map's gradient and the sd of the blur common to all pixels, in device pixels."""

    box_px: Float64[np.ndarray, "pixels 2"]
    blur_px: float

    def predicted(self) -> Float64[np.ndarray, " pixels"]:
        """Return the logarithm of the total standard deviation."""
        return 0.5 * np.log((self.box_px**2).sum(axis=1) / 12 + self.blur_px**2)


def known_prior(footprints: Footprints, *, sd: float) -> WidthPrior:
    """Return the prior of footprints whose widths are known to a relative ``sd``."""
    log_width = footprints.predicted()
    return WidthPrior(shape_of(footprints.box_px, np.exp(log_width)), log_width, np.full(len(log_width), sd))


def neighbours_prior(
    fit: StripeFit,
    fitted: np.ndarray,
    footprints: Footprints,
    pixels: np.ndarray,
    *,
    grid: tuple[int, int],
) -> WidthPrior:
    """Return the prior of every pixel of ``pixels`` from the ``fit`` of some of them (rows ``fitted`` of the list)."""
    predicted = footprints.predicted()
    wider = fit.log_width - predicted[fitted]
    own = 1 / np.maximum(fit.width_information, 1e-9)
    weight = np.where(fit.chi_square < WORST_CHI_SQUARE * fit.freedom, 1 / (own + NEIGHBOUR_SD**2), 0.0)

    def summed(values: np.ndarray) -> np.ndarray:
        image = np.zeros(grid)
        image.ravel()[pixels[fitted]] = values
        total = cv2.boxFilter(
            image, cv2.CV_64F, (WINDOW_PX, WINDOW_PX), normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        return total.ravel()[pixels]

    total = np.maximum(summed(weight), 0.0) + GRADIENT_SD**-2
    mean = summed(weight * wider) / total
    scatter = summed(weight * np.maximum((wider - mean[fitted]) ** 2 - own, 0.0)) / total
    log_width = predicted + mean
    sd = np.sqrt(NEIGHBOUR_SD**2 + np.maximum(scatter, 0.0) + 1 / total)
    return WidthPrior(shape_of(footprints.box_px, np.exp(log_width)), log_width, sd)
