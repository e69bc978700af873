"""What is known beforehand: the derivatives of each constraint are the quotients of small differences."""

import cv2
import numpy as np
import pytest

from recon.calibration.bundle import Constraint
from recon.calibration.bundle_state import BundleState, Freedom, ParameterTable
from recon.calibration.constraints import (
    glass_known,
    lens_known,
    level_known,
    scale_known,
    slipped_little,
    travel_known,
)
from recon.calibration.sight_line import LiquidPlane, PanelPose

RNG = np.random.default_rng(9)
DOWN = np.array([0.1, -0.05, np.sqrt(1 - 0.0125)])
SPREAD = RNG.normal(size=(9, 9))
LENS = np.array([4000.0, 4100, 1900, 1300, 0.1, -0.2, 0.001, 0.002, 0.3])


def state(turn: tuple[float, float, float]) -> BundleState:
    """A state whose wet panel is turned against the dry one by a rotation vector."""
    dry = cv2.Rodrigues(np.array([0.4, -0.3, 2.0]))[0]
    return BundleState(
        lens=LENS,
        panels={
            "dry": PanelPose(dry, np.array([3.0, -4.0, 500.0])),
            "wet": PanelPose(dry @ cv2.Rodrigues(np.array(turn))[0], np.array([5.0, 1.0, 540.0])),
        },
        liquid=LiquidPlane(np.array([0.0, 0.6, 0.8]), 400.0),
        glass_mm=1.5,
        scale=1.01,
    )


@pytest.mark.parametrize(
    "constraint",
    [
        pytest.param(lens_known(LENS + 0.1, SPREAD @ SPREAD.T + np.eye(9)), id="lens"),
        pytest.param(travel_known("dry", "wet", travel_mm=40.0, sd_mm=0.02), id="travel"),
        pytest.param(slipped_little("dry", "wet", sd=(0.005, 0.004, 0.003, 0.5, 0.4, 0.05)), id="slip"),
        pytest.param(level_known(LiquidPlane(DOWN, 390.0), tilt_sd_rad=0.01, distance_sd_mm=2.0), id="level"),
        pytest.param(scale_known(sd=0.02), id="scale"),
        pytest.param(glass_known(1.4, sd_mm=0.1), id="glass"),
    ],
)
@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (2e-3, -1e-3, 3e-3), (0.7, -0.5, 0.4)])
def test_derivatives_are_quotients_of_small_differences(
    constraint: Constraint, turn: tuple[float, float, float]
) -> None:
    here = state(turn)
    table = ParameterTable.of(here, Freedom(lens=True, liquid=True, glass=True, scale=True))
    told = constraint.derivatives(here)
    for name, part in table.parts.items():
        for number in range(part.start, part.stop):
            nudge = np.zeros(table.count)
            nudge[number] = table.nudge[number]
            ahead, behind = (constraint.misses(table.moved(here, step)) for step in (nudge, -nudge))
            expected = (ahead - behind) / (2 * table.nudge[number])
            found = told[name][:, number - part.start] if name in told else np.zeros(len(expected))
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(constraint.misses(here)).max())
