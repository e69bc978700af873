"""Our figures beside the published ones: rows for people, for the report and for other programs."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from recon.evaluation.cylinder import CylinderFit
from recon.evaluation.facets import Facets
from recon.evaluation.published import PUBLISHED
from recon.evaluation.sphere import SphereFit
from recon.evaluation.spread import Spread
from recon.evaluation.truth import TruthComparison

Published = Mapping[str, tuple[float, float]]

NONE: Published = {}


@dataclass(frozen=True, slots=True)
class Row:
    """One figure: what it is of, its name, ours, and the published range (its ends are equal for a single figure)."""

    of: str
    quantity: str
    ours: float | int
    unit: str
    published: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class KnownSize:
    """The object's size as a caliper says, where someone measured it."""

    radius_mm: float | None = None
    height_mm: float | None = None


def truth_rows(comparison: TruthComparison, *, unit: str) -> Iterator[Row]:
    """Return the comparison with truth, pixel by pixel."""
    yield Row("truth", "judged pixels", comparison.judged, "px")
    yield Row("truth", "complete", 100 * comparison.complete, "%")
    yield Row("truth", "false points", comparison.false_points, "px")
    yield from _error_rows("truth", comparison.point_mm, comparison.normal_rad, unit=unit, published=NONE)
    yield Row("truth", "position error over its own sd, rms", comparison.normalised_rms, "")


def ellipsoid_rows(distance_mm: Spread, *, unit: str) -> Iterator[Row]:
    """Return the distances to a known ellipsoid."""
    yield Row("ellipsoid", "points", distance_mm.count, "px")
    yield from _spread_rows("ellipsoid", "distance", distance_mm, unit=unit, published=NONE)


def sphere_rows(fit: SphereFit, *, known: KnownSize, unit: str) -> Iterator[Row]:
    """Return the fitted sphere and the errors against it."""
    published = PUBLISHED["sphere"]
    yield Row("sphere", "points", fit.position_mm.count, "px", published["points"])
    yield from _size_rows("sphere", "radius", fit.sphere.radius_mm, known.radius_mm, unit=unit, published=published)
    yield from _error_rows("sphere", fit.position_mm, fit.normal_rad, unit=unit, published=published)


def cylinder_rows(fit: CylinderFit, *, known: KnownSize, unit: str) -> Iterator[Row]:
    """Return the fitted cylinder and the errors against it."""
    published = PUBLISHED["cylinder"]
    yield Row("cylinder", "points", fit.position_mm.count, "px", published["points"])
    radius_mm = fit.cylinder.radius_mm
    yield from _size_rows("cylinder", "radius", radius_mm, known.radius_mm, unit=unit, published=published)
    yield from _size_rows("cylinder", "height", fit.height_mm, known.height_mm, unit=unit, published=published)
    yield Row("cylinder", "inliers", 100 * fit.inlier_share, "%", published["inliers"])
    yield from _error_rows("cylinder", fit.position_mm, fit.normal_rad, unit=unit, published=published)


def facet_rows(facets: Facets, *, unit: str) -> Iterator[Row]:
    """Return each facet's plane and the errors against it."""
    published = PUBLISHED["planes"]
    yield Row("facets", "facets", len(facets.planes), "", published["facets"])
    yield Row("facets", "points", int((facets.number >= 0).sum()), "px", published["points"])
    for number, fit in enumerate(facets.planes, start=1):
        name = f"facet {number}"
        yield Row(name, "inliers", 100 * fit.inlier_share, "%", published["inliers"])
        yield from _error_rows(name, fit.position_mm, fit.normal_rad, unit=unit, published=published)


def _size_rows(
    of: str, quantity: str, ours_mm: float, known_mm: float | None, *, unit: str, published: Published
) -> Iterator[Row]:
    yield Row(of, quantity, ours_mm, unit, published[quantity])
    if known_mm is not None:
        yield Row(of, f"known {quantity}", known_mm, unit, published[f"known {quantity}"])
        off = 100 * abs(ours_mm / known_mm - 1)
        yield Row(of, f"{quantity} off by", off, "%", published[f"{quantity} off by"])


def _error_rows(of: str, position_mm: Spread, normal_rad: Spread, *, unit: str, published: Published) -> Iterator[Row]:
    yield from _spread_rows(of, "position error", position_mm, unit=unit, published=published)
    yield from _spread_rows(of, "normal error", _in_degrees(normal_rad), unit="deg", published=published)


def _spread_rows(of: str, name: str, spread: Spread, *, unit: str, published: Published) -> Iterator[Row]:
    for figure in ("mean", "median", "rms", "p95"):
        quantity = f"{name}, {figure}"
        yield Row(of, quantity, float(getattr(spread, figure)), unit, published.get(quantity))


def _in_degrees(spread: Spread) -> Spread:
    figures = (float(np.degrees(value)) for value in (spread.mean, spread.median, spread.rms, spread.p95))
    return Spread(spread.count, *figures)
