"""What is known beforehand, as soft constraints of the adjustment: each a list of misses over their standard deviations."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from jaxtyping import Float64

from recon.calibration.bundle import Constraint
from recon.calibration.bundle_state import GLASS, LENS, LIQUID, SCALE, BundleState, across
from recon.calibration.lens import Lens
from recon.calibration.sight_line import LiquidPlane, PanelPose


def lens_known(lens: Lens, covariance: Float64[np.ndarray, "9 9"]) -> Constraint:
    """The lens was calibrated before, with this covariance."""
    scale = np.sqrt(np.diag(covariance))
    # The inverse root of the scaled matrix: focal lengths and k3 differ by eight powers of ten.
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    whiten = (vectors / np.sqrt(np.maximum(values, 1e-12))) @ vectors.T / scale

    def misses(state: BundleState) -> Float64[np.ndarray, " _"]:
        return whiten @ (state.lens - lens)

    return Constraint(misses, lambda _: {LENS: whiten})


def travel_known(first: str, second: str, *, travel_mm: float, sd_mm: float) -> Constraint:
    """The stage carried the panel this far from the one place to the other."""

    def moved_mm(state: BundleState) -> Float64[np.ndarray, " 3"]:
        return state.panels[second].centre_mm - state.panels[first].centre_mm

    def misses(state: BundleState) -> Float64[np.ndarray, " _"]:
        return np.array([(np.linalg.norm(moved_mm(state)) - travel_mm) / sd_mm])

    def derivatives(state: BundleState) -> Mapping[str, Float64[np.ndarray, "_ numbers"]]:
        moved = moved_mm(state)
        by_second = np.append(np.zeros(3), moved / np.linalg.norm(moved) / sd_mm)[np.newaxis]
        return {first: -by_second, second: by_second}

    return Constraint(misses, derivatives)


def slipped_little(dry: str, wet: str, *, sd: Sequence[float]) -> Constraint:
    """The panel moved little between two sets at the same position.

    ``sd`` holds six: turn about the panel's own x, y, z (rad), shift along them (mm); z is the panel's depth.
    """
    over = 1 / np.asarray(sd, dtype=np.float64)

    def misses(state: BundleState) -> Float64[np.ndarray, " _"]:
        return slip(state.panels[dry], state.panels[wet]) * over

    def derivatives(state: BundleState) -> Mapping[str, Float64[np.ndarray, "_ numbers"]]:
        by_dry, by_wet = slip_derivatives(state.panels[dry], state.panels[wet])
        return {dry: by_dry * over[:, np.newaxis], wet: by_wet * over[:, np.newaxis]}

    return Constraint(misses, derivatives)


def level_known(liquid: LiquidPlane, *, tilt_sd_rad: float, distance_sd_mm: float) -> Constraint:
    """The liquid's surface is about there; an infinite sd says nothing."""
    first, second = across(liquid.down)

    def misses(state: BundleState) -> Float64[np.ndarray, " _"]:
        assert state.liquid is not None, "a level is constrained only where there is liquid"
        lean = np.array([state.liquid.down @ first, state.liquid.down @ second])
        return np.append(lean / tilt_sd_rad, (state.liquid.distance_mm - liquid.distance_mm) / distance_sd_mm)

    def derivatives(state: BundleState) -> Mapping[str, Float64[np.ndarray, "_ numbers"]]:
        assert state.liquid is not None, "a level is constrained only where there is liquid"
        by_tilt = np.array([[axis @ other for other in across(state.liquid.down)] for axis in (first, second)])
        by_number = np.zeros((3, 3))
        by_number[:2, :2], by_number[2, 2] = by_tilt / tilt_sd_rad, 1 / distance_sd_mm
        return {LIQUID: by_number}

    return Constraint(misses, derivatives)


def scale_known(*, sd: float) -> Constraint:
    """The pitch is as the maker says, to a share of ``sd``."""
    return Constraint(lambda state: np.array([(state.scale - 1) / sd]), lambda _: {SCALE: np.array([[1 / sd]])})


def glass_known(thickness_mm: float, *, sd_mm: float) -> Constraint:
    """The cover glass is about so thick."""
    return Constraint(
        lambda state: np.array([(state.glass_mm - thickness_mm) / sd_mm]), lambda _: {GLASS: np.array([[1 / sd_mm]])}
    )


def turn_between(first: PanelPose, second: PanelPose) -> Float64[np.ndarray, " 3"]:
    """Return the rotation vector that turns the first panel's axes into the second's, about the first panel's own axes."""
    turn = first.rotation.T @ second.rotation
    vector = cv2.Rodrigues(turn)[0].ravel()
    if vector.any():
        return vector
    # OpenCV returns zeros for turns below 10⁻⁵ rad, whose vector is the matrix's own odd half.
    return 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])


def slip(first: PanelPose, second: PanelPose) -> Float64[np.ndarray, " 6"]:
    """Return turn (rad) and shift (mm) from the first pose to the second, about and along the first panel's own axes."""
    shift_mm = first.rotation.T @ (second.centre_mm - first.centre_mm)
    return np.concatenate([turn_between(first, second), shift_mm])


def slip_derivatives(
    first: PanelPose, second: PanelPose
) -> tuple[Float64[np.ndarray, "6 6"], Float64[np.ndarray, "6 6"]]:
    """Return the derivatives of :func:`slip` by either pose's turn about the camera's axes (rad) and centre (mm).

    A small turn δ after a turn t changes its rotation vector by δ − ½ t×δ + c t×(t×δ), with c = 1/|t|² − (1 + cos |t|) /
    (2 |t| sin |t|): the inverse left Jacobian of SO(3) (Solà, Deray & Atchuthan 2018, eq. 146).
    """
    turn, to_first = turn_between(first, second), first.rotation.T
    angle = float(np.linalg.norm(turn))
    # Near 0 the fraction's own digits are gone; its series begins with 1/12 + |t|²/720.
    curl = 1 / angle**2 - (1 + np.cos(angle)) / (2 * angle * np.sin(angle)) if angle > 1e-2 else 1 / 12 + angle**2 / 720
    cross = _cross_matrix(turn)
    by_second = np.zeros((6, 6))
    by_second[:3, :3] = (np.eye(3) - 0.5 * cross + curl * cross @ cross) @ to_first
    by_second[3:, 3:] = to_first
    by_first = -by_second
    by_first[3:, :3] = to_first @ _cross_matrix(second.centre_mm - first.centre_mm)
    return by_first, by_second


def _cross_matrix(vector: Float64[np.ndarray, " 3"]) -> Float64[np.ndarray, "3 3"]:
    """Return the matrix that multiplies by this vector from the left, as a cross product."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
