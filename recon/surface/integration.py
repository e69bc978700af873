"""Normals to a surface on the camera's grid, without positions: which form of integration, on which rays, and the constants.

The equations see depth only up to a constant a connected part (a factor, where all rays meet), which the triangulated points
supply.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int32

from recon.surface.bilateral_integration import integrate_bilateral
from recon.surface.discrete_integration import integrate_discrete
from recon.surface.quadratic_integration import integrate_quadratic
from recon.surface.ray_bundle import Mask, RayBundle, ScalarMap, VectorMap

Integration = Literal["quadratic", "discrete", "bilateral"]
Vector3 = Float64[np.ndarray, " 3"]

_Solve = Callable[[np.ndarray, RayBundle, Mask], tuple[ScalarMap, np.ndarray]]
SOLVERS: dict[Integration, _Solve] = {
    "quadratic": integrate_quadratic,
    "discrete": integrate_discrete,
    "bilateral": integrate_bilateral,
}
# What is left of the neglect of rays that do not meet falls by the object's depth over its distance in each round.
START_FORMS: tuple[Integration, Integration] = ("quadratic", "quadratic")
# Anchors that are surer than all but so many count like these.
SUREST_SHARE = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class IntegratedSurface:
    """Depth along the rays and the points there; NaN outside the mask, ``part`` −1 there.

    ``part`` numbers the connected parts, each of which has its own free constant.
    """

    depth_mm: ScalarMap
    point_mm: VectorMap
    part: Int32[np.ndarray, "rows cols"]


def integrate_orthographic(
    normal: VectorMap,
    mask: Mask,
    *,
    origin_mm: VectorMap,
    direction: Vector3,
    anchor_depth_mm: ScalarMap | None = None,
    integration: Integration = "quadratic",
) -> IntegratedSurface:
    """Integrate normals seen along parallel rays ``origin_mm + depth · direction``.

    ``anchor_depth_mm`` (NaN where unknown) sets each part's constant by the median of the difference; a part without any
    anchor has mean depth 0.
    """
    along = np.broadcast_to(direction, origin_mm.shape)
    rays = RayBundle.at_distance(origin_mm, along, np.zeros(mask.shape))
    depth, part = _solved(normal, mask, rays, integration)
    depth = _anchored(depth, part, anchor_depth_mm)
    return IntegratedSurface(depth, origin_mm + depth[..., None] * along, part)


def integrate_perspective(
    normal: VectorMap,
    mask: Mask,
    *,
    centre_mm: Vector3,
    direction: VectorMap,
    anchor_depth_mm: ScalarMap | None = None,
    integration: Integration = "quadratic",
) -> IntegratedSurface:
    """Integrate normals seen from one centre along rays ``centre_mm + depth · direction``.

    The unknown is the logarithm of depth, in which the equations are linear: log(d_j / d_i) = log((n·r_i) / (n·r_j)).
    ``anchor_depth_mm`` (NaN where unknown) sets each part's factor by the median of the ratio; a part without any anchor has a
    geometric mean depth of 1.
    """
    logarithm, part = _solved(normal, mask, RayBundle.from_one_centre(direction), integration)
    anchor = None
    if anchor_depth_mm is not None:
        with np.errstate(invalid="ignore", divide="ignore"):
            anchor = np.log(anchor_depth_mm)
    depth = np.exp(_anchored(logarithm, part, anchor))
    return IntegratedSurface(depth, centre_mm + depth[..., None] * direction, part)


def integrate_on_rays(
    normal: VectorMap,
    mask: Mask,
    *,
    origin_mm: VectorMap,
    direction: VectorMap,
    anchor_distance_mm: ScalarMap,
    anchor_sd_mm: ScalarMap,
    integration: Integration = "quadratic",
) -> IntegratedSurface:
    """Integrate normals seen along rays that need not meet, ``origin_mm + depth · direction``.

    ``anchor_distance_mm`` and its standard deviation (NaN where unknown) set each part's constant by the median of the
    difference, in which each counts by the inverse of its variance, the surest hundredth alike: paths that do not belong
    together cross at a wide angle, and look surer than all others. Parts without any are left out. The equations are taken
    about a guess of the distances: first the same one for all, then those that the quadratic form finds.
    """
    weight = np.zeros(mask.shape)
    known = mask & np.isfinite(anchor_distance_mm) & (anchor_sd_mm > 0)
    if known.any():
        sd_mm = anchor_sd_mm[known]
        weight[known] = np.maximum(sd_mm, np.quantile(sd_mm, SUREST_SHARE)) ** -2.0
    one_part = np.where(mask, 0, -1).astype(np.int32)
    flat = np.where(mask, 0.0, np.nan)
    distance = _with_constants(flat, one_part, anchor_distance_mm, weight)
    part = one_part
    forms: tuple[Integration, ...] = (*START_FORMS, integration)
    for form in forms:
        unknown, part = _solved(normal, mask, RayBundle.at_distance(origin_mm, direction, distance), form)
        distance = _with_constants(unknown, part, anchor_distance_mm, weight)
    part = np.where(np.isfinite(distance), part, np.int32(-1))
    return IntegratedSurface(distance, origin_mm + distance[..., None] * direction, part)


def _solved(normal: VectorMap, mask: Mask, rays: RayBundle, integration: Integration) -> tuple[ScalarMap, np.ndarray]:
    used = mask & np.isfinite(normal).all(axis=2) & rays.complete()
    return SOLVERS[integration](normal[used], rays, used)


def _anchored(unknown: ScalarMap, part: np.ndarray, anchor: ScalarMap | None) -> ScalarMap:
    """Add each part's median difference to its anchors, or take its mean off where it has none."""
    solved = part >= 0
    mean = np.bincount(part[solved], unknown[solved]) / np.maximum(np.bincount(part[solved]), 1)
    centred = unknown.copy()
    centred[solved] -= mean[part[solved]]
    if anchor is None:
        return centred
    anchored = _with_constants(centred, part, anchor, solved.astype(np.float64))
    return np.where(np.isfinite(anchored), anchored, centred)


def _with_constants(unknown: ScalarMap, part: np.ndarray, anchor: ScalarMap, weight: ScalarMap) -> ScalarMap:
    """Add each part's weighted median difference to its anchors; NaN where a part has none."""
    known = (part >= 0) & np.isfinite(anchor) & np.isfinite(unknown) & (weight > 0)
    constant = np.full(int(part.max(initial=-1)) + 2, np.nan)  # the last one is that of part −1
    medians = weighted_medians((anchor - unknown)[known], weight[known], part[known])
    for number, median in medians.items():
        constant[number] = median
    return unknown + constant[part]


def weighted_medians(values: np.ndarray, weight: np.ndarray, group: np.ndarray) -> dict[int, float]:
    """Return each group's weighted median; where the weights fall into two equal halves, the middle between them.

    Examples
    --------
    >>> weighted_medians(np.array([1.0, 2.0, 9.0, 5.0]), np.array([1.0, 1.0, 3.0, 1.0]), np.array([0, 0, 0, 1]))
    {0: 9.0, 1: 5.0}
    >>> weighted_medians(np.array([1.0, 2.0]), np.ones(2), np.zeros(2, dtype=int))
    {0: 1.5}
    """
    order = np.lexsort((values, group))
    labels, start = np.unique(group[order], return_index=True)
    medians = {}
    for label, members in zip(labels, np.split(order, start)[1:], strict=True):
        upto = np.cumsum(weight[members])
        half = 0.5 * upto[-1]
        low = np.searchsorted(upto, half * (1 - 1e-12))
        high = np.searchsorted(upto, half * (1 + 1e-12), side="right")
        medians[int(label)] = float(0.5 * (values[members[low]] + values[members[high]]))
    return medians
