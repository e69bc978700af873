"""One least-squares adjustment of everything that boards on the display tell: lens, poses, liquid level, cover glass, scale.

Residuals are corners (measured less predicted, in px over their sd) and soft constraints (what is known beforehand, each over
its sd), so that the inverse of JᵀJ is the covariance. A corner is compared on the screen, where the exact path from the camera
ends (:mod:`recon.calibration.sight_line`), and the difference is carried back to the photo by the path's own derivative: no
search for the path is needed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64
from scipy.optimize import OptimizeResult, least_squares

from recon.calibration.bundle_state import BundleState, Freedom, ParameterTable
from recon.calibration.detection import BoardView
from recon.calibration.errors import CalibrationError
from recon.calibration.lens import Lens, solve_2_by_2, view_rays
from recon.calibration.sight_line import panel_places

# Half a step of the derivatives that carry a difference on the screen back to the photo.
NUDGE_PX = 0.5
ROUNDS = 8
# A corner this many robust sigmas off is a wrong one (1 in 10⁷ good ones, both axes).
OUTLIER_SIGMA = 5.5
MAD_TO_SD = 1.4826
FEWEST_CORNERS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """One photo of the board on the display: where the panel stood (a name), and whether liquid lay before it."""

    view: BoardView
    panel: str
    wet: bool = False


@dataclass(frozen=True, slots=True)
class Media:
    """Refractive indices: of air, of the liquid, of the cover glass."""

    n_air: float = 1.0
    n_liquid: float = 1.0
    n_glass: float = 1.0


# A soft constraint: from the state to numbers that would be 0 if all were as known, each over its standard deviation.
Constraint = Callable[[BundleState], Float64[np.ndarray, " _"]]


@dataclass(frozen=True, slots=True, eq=False)
class BundleResult:
    """The adjusted state with its covariance.

    Attributes
    ----------
    covariance : of the free parameters, in the order of ``table``.
    corner_sd_px : sd of a corner along each axis, from the residuals.
    rms_px : root mean square reprojection error over both axes of the corners that were kept.
    residual_px : of each sighting's corners, in order, dropped ones included.
    kept : which corners of each sighting were used.
    constraint_sigma : how far the soft constraints are off at the solution, in their sd.
    """

    state: BundleState
    table: ParameterTable
    covariance: Float64[np.ndarray, "parameters parameters"]
    corner_sd_px: float
    rms_px: float
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
    kept = [np.ones(len(sighting.view.corner), bool) for sighting in sightings]
    state, sd_px = start, corner_sd_px
    for _ in range(ROUNDS):
        problem = _Problem(state, table, tuple(sightings), tuple(kept), media, tuple(constraints), sd_px)
        solution = _solved(problem)
        state = table.moved(state, solution.x)
        residuals = [corner_residuals(state, sighting, media=media) for sighting in sightings]
        now_kept = _kept(residuals, kept)
        new_sd_px = _corner_sd(residuals, now_kept, problem, solution.jac)
        settled = abs(new_sd_px / sd_px - 1) < 1e-2 and all(map(np.array_equal, kept, now_kept))
        kept, sd_px = now_kept, new_sd_px
        if settled:
            break
    final = replace(problem, state=state, kept=tuple(kept), corner_sd_px=sd_px)
    jacobian = final.jacobian(np.zeros(table.count))
    used = np.concatenate([residual[keep] for residual, keep in zip(residuals, kept, strict=True)])
    return BundleResult(
        state=state,
        table=table,
        covariance=_inverse(jacobian.T @ jacobian),
        corner_sd_px=sd_px,
        rms_px=float(np.sqrt((used**2).sum(axis=1).mean())),
        residual_px=tuple(residuals),
        kept=tuple(kept),
        constraint_sigma=final.constraint_values(state),
    )


def sighting_rays(view: BoardView, lens: Lens) -> Float64[np.ndarray, "five corners 3"]:
    """Return the rays through a view's corners, and through four places close to each, for derivatives."""
    nudges = NUDGE_PX * np.array([[0.0, 0.0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    places = view.place_px[None] + nudges[:, None]
    return view_rays(places.reshape(-1, 2), lens).reshape(5, -1, 3)


def corner_residuals(
    state: BundleState,
    sighting: Sighting,
    *,
    media: Media,
    rays: Float64[np.ndarray, "five corners 3"] | None = None,
) -> Float64[np.ndarray, "corners 2"]:
    """Return measured less predicted places of a sighting's corners in the photo, px; ``rays`` are those of the state's lens."""
    view = sighting.view
    through = sighting_rays(view, state.lens) if rays is None else rays
    seen = panel_places(
        through.reshape(-1, 3),
        state.panels[sighting.panel],
        n_air=media.n_air,
        liquid=state.liquid if sighting.wet else None,
        n_liquid=media.n_liquid,
        glass_mm=state.glass_mm,
        n_glass=media.n_glass,
    ).reshape(5, -1, 2)
    mm_per_px = np.stack([seen[1] - seen[2], seen[3] - seen[4]], axis=2) / (2 * NUDGE_PX)
    return solve_2_by_2(mm_per_px, seen[0] - state.scale * view.board_mm)


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    state: BundleState
    table: ParameterTable
    sightings: tuple[Sighting, ...]
    kept: tuple[np.ndarray, ...]
    media: Media
    constraints: tuple[Constraint, ...]
    corner_sd_px: float

    def values(self, step: np.ndarray) -> np.ndarray:
        state = self.table.moved(self.state, step)
        parts = [self._corners(state, number, None) for number in range(len(self.sightings))]
        return np.concatenate([*parts, self.constraint_values(state)])

    def constraint_values(self, state: BundleState) -> np.ndarray:
        return np.concatenate([np.zeros(0), *(constraint(state) for constraint in self.constraints)])

    def jacobian(self, step: np.ndarray) -> np.ndarray:
        """Return the central differences; a panel's pose moves its own sightings and the constraints only."""
        here = self.table.moved(self.state, step)
        rays = [sighting_rays(sighting.view, here.lens) for sighting in self.sightings]
        columns = []
        for number in range(self.table.count):
            nudge = np.zeros(self.table.count)
            nudge[number] = self.table.nudge[number]
            ahead, behind = self.table.moved(self.state, step + nudge), self.table.moved(self.state, step - nudge)
            owner, same_rays = self.table.owner(number), not self.table.is_lens(number)
            parts = [
                self._corners(ahead, one, rays[one] if same_rays else None)
                - self._corners(behind, one, rays[one] if same_rays else None)
                if owner is None or owner == sighting.panel
                else np.zeros(2 * np.count_nonzero(self.kept[one]))
                for one, sighting in enumerate(self.sightings)
            ]
            parts.append(self.constraint_values(ahead) - self.constraint_values(behind))
            columns.append(np.concatenate(parts) / (2 * nudge[number]))
        return np.column_stack(columns)

    def _corners(self, state: BundleState, number: int, rays: np.ndarray | None) -> np.ndarray:
        residual = corner_residuals(state, self.sightings[number], media=self.media, rays=rays)
        return residual[self.kept[number]].ravel() / self.corner_sd_px


def _solved(problem: _Problem) -> OptimizeResult:
    try:
        solution = least_squares(
            problem.values,
            np.zeros(problem.table.count),
            jac=problem.jacobian,
            method="lm",
            x_scale="jac",
            xtol=1e-9,
            ftol=1e-9,
            gtol=1e-9,
            max_nfev=100,
        )
    except (ValueError, np.linalg.LinAlgError) as error:
        raise CalibrationError(
            f"display poses: no solution from where they were first seen ({error}); check index, pitch and photos"
        ) from None
    return solution


def _kept(residuals: list[np.ndarray], kept: list[np.ndarray]) -> list[np.ndarray]:
    """Return which corners are within so many robust sigmas, taken over all that are kept now."""
    used = np.concatenate([residual[keep] for residual, keep in zip(residuals, kept, strict=True)])
    sigma = MAD_TO_SD * float(np.median(np.abs(used)))
    return [(np.abs(residual) <= OUTLIER_SIGMA * max(sigma, 1e-6)).all(axis=1) for residual in residuals]


def _corner_sd(residuals: list[np.ndarray], kept: list[np.ndarray], problem: _Problem, jacobian: np.ndarray) -> float:
    """Return the sd of a corner: its degrees of freedom are less by what the corners, not the constraints, determine."""
    squares = sum(float((residual[keep] ** 2).sum()) for residual, keep in zip(residuals, kept, strict=True))
    count = 2 * sum(int(np.count_nonzero(keep)) for keep in kept)
    corners = jacobian[: len(jacobian) - len(problem.constraint_values(problem.state))]
    explained = float(np.trace(_inverse(jacobian.T @ jacobian) @ (corners.T @ corners)))
    return max(float(np.sqrt(squares / max(count - explained, 1.0))), 1e-6)


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
