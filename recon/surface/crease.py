"""On which side of a crease a pixel looks, told by the two surfaces that meet there."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.special import ndtr

from recon.surface.local_surfaces import Guess

# Pixels that see both sides of a crease look, on the mean, so far beside their centres.
MIXED_PX = 0.25

Some = Bool[np.ndarray, " places"]
PerPlace = Float64[np.ndarray, " places"]


@dataclass(frozen=True, slots=True, eq=False)
class Crease:
    """Which pixels look near the crease of two surfaces, which of them at the first, and how likely that is the wrong one."""

    meets: Some
    on_first: Some
    wrong_side: PerPlace


def crease_between(one: Guess, other: Guess, spacing_mm: PerPlace) -> Crease:
    """Compare two surfaces at each of some pixels, whose neighbours' points are ``spacing_mm`` apart.

    The distance from the one to the other along their mean normal changes its sign where they meet: a jump has no such place. A
    pixel farther from there than its neighbours are apart looks at neither.
    """
    mean = one.normal + other.normal
    length = np.maximum(np.linalg.norm(mean, axis=1), 1e-3)
    between = one.centre_mm - other.centre_mm
    # By the tangent planes: the first one over the other at its own window, and at the other's.
    at_first, at_second = (
        (between * guess.normal).sum(axis=1) / np.maximum((guess.normal * mean).sum(axis=1), 1e-3)
        for guess in (other, one)
    )
    turn = np.linalg.norm(one.normal - other.normal, axis=1)
    here = ((one.point_mm - other.point_mm) * mean).sum(axis=1) / length
    known = np.isfinite(one.variance_mm2) & np.isfinite(other.variance_mm2)
    slide_mm2 = 0.5 * np.where(known, one.variance_mm2 + other.variance_mm2, 0.0) + (MIXED_PX * spacing_mm) ** 2
    # A point that slides along its surface rises against the mean of both normals.
    noise_mm2 = np.where(known, one.across_mm2 + other.across_mm2, 0.0) + (turn / 2) ** 2 * slide_mm2
    meets = known & (at_first * at_second < 0) & (np.abs(here) < spacing_mm * turn)
    apart = np.divide(np.abs(here), np.sqrt(noise_mm2), out=np.zeros_like(here), where=noise_mm2 > 0)
    return Crease(meets, here * at_first > 0, ndtr(-apart))
