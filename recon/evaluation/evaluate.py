"""Evaluate one run: its maps against truth, a known ellipsoid or a fitted primitive."""

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from recon.errors import ReconError
from recon.evaluation.cylinder import fit_cylinder
from recon.evaluation.ellipsoid import ellipsoid_distance_mm
from recon.evaluation.facets import fit_facets
from recon.evaluation.published import CITATION, MOST_FACETS, THRESHOLD_MM, Primitive
from recon.evaluation.sphere import fit_sphere
from recon.evaluation.spread import Spread, spread_of
from recon.evaluation.table import (
    KnownSize,
    Row,
    cylinder_rows,
    ellipsoid_rows,
    facet_rows,
    sphere_rows,
    truth_rows,
)
from recon.evaluation.truth import Truth, compare_with_truth, judged_points, load_truth
from recon.maps import MAPS_NAME, Maps, load_maps
from recon.metrics import METRICS_NAME, load_metrics
from recon.sessions.session import TRUTH_NAME

EVALUATION_NAME = "evaluation.json"
UNKNOWN_SIZE = KnownSize()


@dataclass(frozen=True, slots=True)
class EvaluationResult:
    """The figures of one run, in the order in which they are shown."""

    run: str
    method: str
    length_unit: str
    rows: tuple[Row, ...]


def evaluate(
    run_folder: Path,
    *,
    primitive: Primitive | None = None,
    truth: Path | None = None,
    ellipsoid_mm: tuple[float, float, float] | None = None,
    known: KnownSize = UNKNOWN_SIZE,
    ring_mm: tuple[float, float] | None = None,
    most_facets: int = MOST_FACETS,
    threshold_mm: float = THRESHOLD_MM,
    seed: int = 0,
) -> EvaluationResult:
    """Compare a run's points and normals with whatever is asked for.

    Parameters
    ----------
    run_folder
        What ``recon run`` wrote.
    primitive
        The shape to fit to all points.
    truth
        Truth file, or the folder of the simulated session. Where nothing at all is asked for, that of the session in
        which the run lies.
    ellipsoid_mm
        Semi-axes of a known ellipsoid about the origin; with a truth file, only judged pixels are measured against it.
    known
        The object's size, measured by other means.
    ring_mm
        Judge against truth only where its point lies between these distances from the z axis.
    most_facets, threshold_mm, seed
        Settings of the fits: facets to look for, inlier threshold, start of the random draws.

    Raises
    ------
    ReconError
        Where a file is missing or unfit, or nothing can be fitted.
    """
    maps = load_maps(run_folder / MAPS_NAME)
    method, unit = _method_and_unit(run_folder)
    if primitive is None and truth is None and ellipsoid_mm is None:
        truth = run_folder.resolve().parent / TRUTH_NAME
        if not truth.exists():
            raise ReconError(
                f"{run_folder}: nothing to compare with; give --primitive, --truth or --ellipsoid "
                "(only simulated sessions carry their truth)"
            )
    rows: list[Row] = []
    known_truth = load_truth(truth) if truth is not None else None
    if known_truth is not None and ring_mm is not None:
        known_truth = _within_ring(known_truth, ring_mm)
    if known_truth is not None:
        rows += truth_rows(compare_with_truth(maps, known_truth), unit=unit)
    if ellipsoid_mm is not None:
        rows += ellipsoid_rows(_ellipsoid_spread(maps, ellipsoid_mm, known_truth), unit=unit)
    if primitive is not None:
        rng = np.random.default_rng(seed)
        rows += _primitive_rows(
            maps, primitive, rng, known=known, unit=unit, most_facets=most_facets, threshold_mm=threshold_mm
        )
    return EvaluationResult(str(run_folder), method, unit, tuple(rows))


def _within_ring(truth: Truth, ring_mm: tuple[float, float]) -> Truth:
    with np.errstate(invalid="ignore"):
        radius = np.hypot(truth.point_mm[..., 0], truth.point_mm[..., 1])
        inside = (radius > ring_mm[0]) & (radius < ring_mm[1])
    return replace(truth, judged=truth.judged & inside)


def save_evaluation(result: EvaluationResult, path: Path) -> None:
    """Write the figures as JSON; a figure that could not be formed is null."""
    rows = [
        {
            "of": row.of,
            "quantity": row.quantity,
            "ours": row.ours if math.isfinite(row.ours) else None,
            "published": row.published,
            "unit": row.unit,
        }
        for row in result.rows
    ]
    content = {
        "schema_version": 1,
        "run": result.run,
        "method": result.method,
        "length_unit": result.length_unit,
        "published": CITATION,
        "rows": rows,
    }
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _method_and_unit(run_folder: Path) -> tuple[str, str]:
    """Return the run's method and unit of length; maps alone are taken to be in mm."""
    if not (run_folder / METRICS_NAME).exists():
        return "unknown", "mm"
    metrics = load_metrics(run_folder / METRICS_NAME)
    return metrics.method, metrics.length_unit


def _ellipsoid_spread(maps: Maps, ellipsoid_mm: tuple[float, float, float], truth: Truth | None) -> Spread:
    used = _points(maps) if truth is None else judged_points(maps, truth)
    return spread_of(ellipsoid_distance_mm(maps.point_mm[used], ellipsoid_mm))


def _points(maps: Maps) -> np.ndarray:
    return maps.valid() & np.isfinite(maps.point_mm).all(axis=2)


def _primitive_rows(
    maps: Maps,
    primitive: Primitive,
    rng: np.random.Generator,
    *,
    known: KnownSize,
    unit: str,
    most_facets: int,
    threshold_mm: float,
) -> list[Row]:
    used = _points(maps)
    point_mm, normal = maps.point_mm[used], maps.normal[used]
    if primitive == "sphere":
        return list(sphere_rows(fit_sphere(point_mm, normal, rng=rng), known=known, unit=unit))
    if primitive == "cylinder":
        fit = fit_cylinder(point_mm, normal, rng=rng, threshold_mm=threshold_mm)
        return list(cylinder_rows(fit, known=known, unit=unit))
    facets = fit_facets(maps.point_mm, maps.normal, used, rng=rng, most_facets=most_facets, threshold_mm=threshold_mm)
    return list(facet_rows(facets, unit=unit))
