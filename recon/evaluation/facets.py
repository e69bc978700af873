"""A faceted object: its facets told apart by their normals, and a plane fitted to each."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int32
from scipy.ndimage import binary_closing, binary_fill_holes, label

from recon.errors import ReconError
from recon.evaluation.consensus import judges
from recon.evaluation.plane import PlaneFit, fit_plane
from recon.evaluation.published import THRESHOLD_MM
from recon.evaluation.spread import unit

NormalMap = Float64[np.ndarray, "rows cols 3"]
Mask = Bool[np.ndarray, "rows cols"]

# Wide enough for the paper's worst facet (10° mean error), narrower than half the angle between facets of common
# gems and ornaments (about 40°).
TOLERANCE_RAD = np.radians(15.0)
# A patch smaller than this share of all points is an edge or noise, not a facet.
SMALLEST_SHARE = 0.02
CANDIDATES = 300
REFINEMENTS = 10
SPECKLE_PX = 2


@dataclass(frozen=True, slots=True, eq=False)
class Facets:
    """The facet number of each pixel (−1 for none) and the plane fitted to each facet, largest first."""

    number: Int32[np.ndarray, "rows cols"]
    planes: tuple[PlaneFit, ...]


def fit_facets(
    point_mm: NormalMap,
    normal: NormalMap,
    mask: Mask,
    *,
    rng: np.random.Generator,
    most_facets: int,
    threshold_mm: float = THRESHOLD_MM,
) -> Facets:
    """Part the pixels into facets and fit a plane to each by RANSAC, judged over all of the facet's points."""
    number = facets_by_normal(normal, mask, rng=rng, most_facets=most_facets)
    count = int(number.max()) + 1
    if not count:
        raise ReconError("no facet found: the normals nowhere agree over an area; is the object faceted?")
    planes = tuple(
        fit_plane(point_mm[number == facet], normal[number == facet], rng=rng, threshold_mm=threshold_mm)
        for facet in range(count)
    )
    return Facets(number, planes)


def facets_by_normal(
    normal: NormalMap, mask: Mask, *, rng: np.random.Generator, most_facets: int, tolerance_rad: float = TOLERANCE_RAD
) -> Int32[np.ndarray, "rows cols"]:
    """Number connected areas of like normals, largest first; −1 elsewhere.

    Time and again the direction that most remaining normals agree with is taken, and its largest connected area becomes a facet.
    """
    left = mask & np.isfinite(normal).all(axis=2)
    smallest = max(3, SMALLEST_SHARE * left.sum())
    areas: list[Mask] = []
    while len(areas) < most_facets and left.sum() >= smallest:
        direction = _commonest(normal[left], rng, np.cos(tolerance_rad))
        alike = left & (normal @ direction >= np.cos(tolerance_rad))
        area = _largest_area(alike)
        if area.sum() < smallest:
            break
        areas.append(area)
        # Strays inside the facet are its noise; they must not seed another facet.
        left &= ~binary_fill_holes(_closed(area))
    number = np.full(mask.shape, -1, np.int32)
    for facet, area in enumerate(sorted(areas, key=lambda area: -int(area.sum()))):
        number[area] = facet
    return number


def _commonest(
    normals: Float64[np.ndarray, "pixels 3"], rng: np.random.Generator, cosine: float
) -> Float64[np.ndarray, " 3"]:
    """Return the direction with the most normals within the tolerance: best of some, then moved to the mean (mean shift)."""
    jury = judges(normals, rng)
    candidates = jury[rng.integers(0, len(jury), CANDIDATES)]
    direction = candidates[((candidates @ jury.T) >= cosine).sum(axis=1).argmax()]
    for _ in range(REFINEMENTS):
        mean = unit(jury[jury @ direction >= cosine].mean(axis=0, keepdims=True))[0]
        if np.allclose(mean, direction, atol=1e-6):
            break
        direction = mean
    return direction


def _largest_area(alike: Mask) -> Mask:
    """Return the largest connected area; gaps of a pixel or two, where a normal is astray, do not part it."""
    joined, count = label(_closed(alike))
    if not count:
        return np.zeros_like(alike)
    sizes = np.bincount(joined[alike], minlength=count + 1)
    sizes[0] = 0
    return alike & (joined == sizes.argmax())


def _closed(area: Mask) -> Mask:
    """Close gaps of a few pixels; the photo's border is no gap."""
    around = (slice(SPECKLE_PX, -SPECKLE_PX),) * 2
    return binary_closing(np.pad(area, SPECKLE_PX, mode="edge"), iterations=SPECKLE_PX)[around]
