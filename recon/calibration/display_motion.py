"""What a calibration says of the display's motion: how straight the stage carried it, whether it slipped as the tank filled."""

import numpy as np
from jaxtyping import Float64

from recon.calibration.calibration_file import Calibration
from recon.calibration.display_poses import AIR_PANELS, Straightness, panel_pose, straightness_between
from recon.calibration.sight_line import PanelPose
from recon.calibration.wet_pose import WET_PANELS, Slip, slip_between


def panels_of(calibration: Calibration) -> dict[str, PanelPose]:
    """Return the display's poses by set."""
    return {name: panel_pose(pose) for name, pose in calibration.poses.items()}


def covariance_of(calibration: Calibration, *names: str) -> Float64[np.ndarray, "numbers numbers"]:
    """Return the joint covariance of the poses of these sets."""
    order = list(calibration.poses)
    chosen = np.concatenate([6 * order.index(name) + np.arange(6) for name in names])  # type: ignore[arg-type]  # set names
    return calibration.pose_covariance()[np.ix_(chosen, chosen)]


def straightness_of(calibration: Calibration) -> Straightness | None:
    """Return how straight the stage carried the display; None where the file has no covariance."""
    if not calibration.covariance:
        return None
    panels = panels_of(calibration)
    first, second = (panels[name] for name in AIR_PANELS)
    return straightness_between(first, second, covariance_of(calibration, *AIR_PANELS))


def slips_of(calibration: Calibration) -> tuple[Slip, ...]:
    """Return how the display moved between dry and wet at each position that was photographed wet."""
    panels = panels_of(calibration)
    return tuple(
        slip_between(position, panels[dry], panels[wet], covariance_of(calibration, dry, wet))
        for position, (dry, wet) in enumerate(zip(AIR_PANELS, WET_PANELS, strict=True))
        if wet in panels and calibration.covariance
    )
