"""One least-squares adjustment of everything that boards on the display tell: lens, poses, liquid level, cover glass, scale.

Residuals are corners (:mod:`recon.calibration.sighting`: measured less predicted, in px over their sd) and soft constraints
(what is known beforehand, each over its sd), so that the inverse of JᵀJ is the covariance.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64
from scipy.optimize import OptimizeResult, least_squares

from recon.calibration.bundle_state import BundleState, Freedom, ParameterTable
from recon.calibration.errors import CalibrationError
from recon.calibration.sighting import Corners, Media, Sighting, corner_derivatives, corner_residuals

ROUNDS = 8
# A corner this many robust sigmas off is a wrong one (1 in 10⁷ good ones, both axes).
OUTLIER_SIGMA = 5.5
MAD_TO_SD = 1.4826
FEWEST_CORNERS = 8


@dataclass(frozen=True, slots=True)
class Constraint:
    """What is known beforehand.

    ``misses`` makes of a state the numbers that would be 0 if all were as known, each over its standard deviation;
    ``derivatives`` are theirs by the numbers of each part of the state that they depend on, as :class:`ParameterTable` lays
    these out.
    """

    misses: Callable[[BundleState], Float64[np.ndarray, " _"]]
    derivatives: Callable[[BundleState], Mapping[str, Float64[np.ndarray, "_ numbers"]]]


@dataclass(frozen=True, slots=True, eq=False)
class BundleResult:
    """The adjusted state with its covariance.

    Attributes
    ----------
    covariance : of the free parameters, in the order of ``table``.
    corner_sd_px : sd of a corner along each axis, from the residuals.
    rms_px : root mean square reprojection error over both axes of the corners that were kept.
    sightings : the photos, in order.
    residual_px : of each sighting's corners, in order, dropped ones included.
    kept : which corners of each sighting were used.
    constraint_sigma : how far the soft constraints are off at the solution, in their sd.
    """

    state: BundleState
    table: ParameterTable
    covariance: Float64[np.ndarray, "parameters parameters"]
    corner_sd_px: float
    rms_px: float
    sightings: tuple[Sighting, ...]
    residual_px: tuple[Float64[np.ndarray, "_ 2"], ...]
    kept: tuple[Bool[np.ndarray, " _"], ...]
    constraint_sigma: Float64[np.ndarray, " _"]

    def covariance_of(self, *names: str) -> Float64[np.ndarray, "chosen chosen"]:
        """Return the joint covariance of the named parts (``lens``, ``liquid``, ``glass``, ``scale`` or a panel's name)."""
        chosen = np.concatenate([np.arange(len(self.covariance))[self.table.part(name)] for name in names])
        return self.covariance[np.ix_(chosen, chosen)]

    def dropped(self) -> int:
        """Return how many corners were left out as wrong."""
        return int(sum(np.count_nonzero(~kept) for kept in self.kept))


def adjust(
    start: BundleState,
    sightings: Sequence[Sighting],
    *,
    freedom: Freedom,
    media: Media,
    constraints: Sequence[Constraint] = (),
    corner_sd_px: float = 0.1,
) -> BundleResult:
    """Adjust the free parameters of ``start`` to the sightings and constraints.

    ``corner_sd_px`` is a first guess; the residuals' own is put in its place, and wrong corners are dropped, until neither
    changes.

    Raises
    ------
    CalibrationError
        Where a sighting has too few corners, or the adjustment finds no solution.
    """
    for sighting in sightings:
        if len(sighting.view.corner) < FEWEST_CORNERS:
            raise CalibrationError(
                f"board at {sighting.panel}: {len(sighting.view.corner)} corners were found, {FEWEST_CORNERS} are needed; "
                "show the board again, sharp, unobstructed and not overexposed"
            )
    table = ParameterTable.of(start, freedom)
    corners = Corners.of(sightings, tuple(start.panels))
    kept = np.ones(len(corners.place_px), bool)
    state, sd_px = start, corner_sd_px
    for _ in range(ROUNDS):
        problem = _Problem(state, table, corners, kept, media, tuple(constraints), sd_px)
        solution = _solved(problem)
        state = table.moved(state, solution.x)
        residual = corner_residuals(state, corners, media=media)
        now_kept = _kept(residual, kept)
        new_sd_px = _corner_sd(residual[now_kept], problem, solution.jac)
        settled = abs(new_sd_px / sd_px - 1) < 1e-2 and np.array_equal(kept, now_kept)
        kept, sd_px = now_kept, new_sd_px
        if settled:
            break
    final = replace(problem, state=state, kept=kept, corner_sd_px=sd_px)
    jacobian = final.jacobian(np.zeros(table.count))
    return BundleResult(
        state=state,
        table=table,
        covariance=_inverse(jacobian.T @ jacobian),
        corner_sd_px=sd_px,
        rms_px=float(np.sqrt((residual[kept] ** 2).sum(axis=1).mean())),
        sightings=tuple(sightings),
        residual_px=corners.split(residual),
        kept=corners.split(kept),
        constraint_sigma=final.constraint_values(state),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    state: BundleState
    table: ParameterTable
    corners: Corners
    kept: np.ndarray
    media: Media
    constraints: tuple[Constraint, ...]
    corner_sd_px: float

    def values(self, step: np.ndarray) -> np.ndarray:
        state = self.table.moved(self.state, step)
        residual = corner_residuals(state, self.corners, media=self.media)[self.kept] / self.corner_sd_px
        return np.concatenate([residual.ravel(), self.constraint_values(state)])

    def constraint_values(self, state: BundleState) -> np.ndarray:
        return np.concatenate([np.zeros(0), *(constraint.misses(state) for constraint in self.constraints)])

    def jacobian(self, step: np.ndarray) -> np.ndarray:
        here = self.table.moved(self.state, step)
        by_corner = corner_derivatives(here, self.corners, self.table, media=self.media)[self.kept] / self.corner_sd_px
        return np.vstack([by_corner.reshape(-1, self.table.count), self._constraint_derivatives(here)])

    def _constraint_derivatives(self, here: BundleState) -> np.ndarray:
        rows = [np.zeros((0, self.table.count))]
        for constraint in self.constraints:
            of_one = np.zeros((len(constraint.misses(here)), self.table.count))
            for name, by_part in constraint.derivatives(here).items():
                if name in self.table.parts:
                    of_one[:, self.table.part(name)] = by_part
            rows.append(of_one)
        return np.vstack(rows)


def _solved(problem: _Problem) -> OptimizeResult:
    try:
        solution = least_squares(
            problem.values,
            np.zeros(problem.table.count),
            jac=problem.jacobian,
            method="lm",
            x_scale="jac",
            xtol=1e-7,
            ftol=1e-7,
            gtol=1e-7,
            max_nfev=100,
        )
    except (ValueError, np.linalg.LinAlgError) as error:
        raise CalibrationError(
            f"display poses: no solution from where they were first seen ({error}); check index, pitch and photos"
        ) from None
    return solution


def _kept(residual: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Return which corners are within so many robust sigmas, taken over all that are kept now."""
    sigma = MAD_TO_SD * float(np.median(np.abs(residual[kept])))
    return (np.abs(residual) <= OUTLIER_SIGMA * max(sigma, 1e-6)).all(axis=1)


def _corner_sd(used: np.ndarray, problem: _Problem, jacobian: np.ndarray) -> float:
    """Return the sd of a corner: its degrees of freedom are less by what the corners, not the constraints, determine."""
    by_corner = jacobian[: 2 * int(np.count_nonzero(problem.kept))]
    explained = float(np.trace(_inverse(jacobian.T @ jacobian) @ (by_corner.T @ by_corner)))
    return max(float(np.sqrt((used**2).sum() / max(used.size - explained, 1.0))), 1e-6)


def _inverse(information: np.ndarray) -> np.ndarray:
    """Invert after scaling each parameter by its own information, since mm, rad and px differ by many powers of ten."""
    scale = np.sqrt(np.diag(information))
    if not np.all(scale > 0):
        raise CalibrationError(
            "display poses: the photos say nothing of one of the unknowns; fix it or show more of the board"
        )
    try:
        inverse = np.linalg.inv(information / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        raise CalibrationError(
            "display poses: two unknowns cannot be told apart by these photos; fix one of them (scale, glass or level)"
        ) from None
    return inverse / np.outer(scale, scale)


__all__ = ["BundleResult", "Constraint", "Media", "Sighting", "adjust"]
