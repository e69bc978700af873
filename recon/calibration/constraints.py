"""What is known beforehand, as soft constraints of the adjustment: each a list of misses over their standard deviations."""

from collections.abc import Sequence

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

    return Constraint(misses, (LENS,))


def travel_known(first: str, second: str, *, travel_mm: float, sd_mm: float) -> Constraint:
    """The stage carried the panel this far from the one place to the other."""

    def misses(state: BundleState) -> Float64[np.ndarray, " _"]:
        moved_mm = np.linalg.norm(state.panels[second].centre_mm - state.panels[first].centre_mm)
        return np.array([(moved_mm - travel_mm) / sd_mm])

    return Constraint(misses, (first, second))


def slipped_little(dry: str, wet: str, *, sd: Sequence[float]) -> Constraint:
    """The panel moved little between two sets at the same position.

    ``sd`` holds six: turn about the panel's own x, y, z (rad), shift along them (mm); z is the panel's depth.
    """

    def misses(state: BundleState) -> Float64[np.ndarray, " _"]:
        return slip(state.panels[dry], state.panels[wet]) / np.asarray(sd, dtype=np.float64)

    return Constraint(misses, (dry, wet))


def level_known(liquid: LiquidPlane, *, tilt_sd_rad: float, distance_sd_mm: float) -> Constraint:
    """The liquid's surface is about there; an infinite sd says nothing."""
    first, second = across(liquid.down)

    def misses(state: BundleState) -> Float64[np.ndarray, " _"]:
        assert state.liquid is not None, "a level is constrained only where there is liquid"
        lean = np.array([state.liquid.down @ first, state.liquid.down @ second])
        return np.append(lean / tilt_sd_rad, (state.liquid.distance_mm - liquid.distance_mm) / distance_sd_mm)

    return Constraint(misses, (LIQUID,))


def scale_known(*, sd: float) -> Constraint:
    """The pitch is as the maker says, to a share of ``sd``."""
    return Constraint(lambda state: np.array([(state.scale - 1) / sd]), (SCALE,))


def glass_known(thickness_mm: float, *, sd_mm: float) -> Constraint:
    """The cover glass is about so thick."""
    return Constraint(lambda state: np.array([(state.glass_mm - thickness_mm) / sd_mm]), (GLASS,))


def turn_between(first: PanelPose, second: PanelPose) -> Float64[np.ndarray, " 3"]:
    """Return the rotation vector that turns the first panel's axes into the second's, about the first panel's own axes."""
    return cv2.Rodrigues(first.rotation.T @ second.rotation)[0].ravel()


def slip(first: PanelPose, second: PanelPose) -> Float64[np.ndarray, " 6"]:
    """Return turn (rad) and shift (mm) from the first pose to the second, about and along the first panel's own axes."""
    shift_mm = first.rotation.T @ (second.centre_mm - first.centre_mm)
    return np.concatenate([turn_between(first, second), shift_mm])
