"""The hand that holds a calibration board before the simulated camera, pose after pose."""

import cv2
import numpy as np

from recon.sessions.manifest import CameraBody
from rig.calibrating.hands import Answer
from rig.errors import ConfigError
from sim_backend.held_sheet import HeldSheet, Print
from sim_backend.optics.screen import ScreenPose
from sim_backend.world import World

# Turn about x, y and z in degrees; the board's middle from the photo's, as shares of the photo; its width as a share of it.
POSES = (
    (0, 0, 0, 0.0, 0.0, 0.85),
    (30, 0, 4, -0.1, -0.1, 0.6),
    (-30, 0, -6, 0.1, 0.1, 0.6),
    (0, 32, 8, 0.1, -0.1, 0.6),
    (0, -32, -4, -0.1, 0.1, 0.6),
    (8, 14, 3, -0.26, -0.26, 0.5),
    (-9, -12, -8, 0.26, -0.26, 0.5),
    (11, -10, 6, -0.26, 0.26, 0.5),
    (-12, 9, -3, 0.26, 0.26, 0.5),
    (24, 22, 30, 0.0, 0.0, 0.7),
    (-22, 25, -35, 0.0, 0.0, 0.7),
    (4, -3, 90, 0.0, 0.0, 0.6),
    (6, 5, 0, 0.0, -0.3, 0.55),
    (-6, 5, 0, 0.0, 0.3, 0.55),
    (5, 28, 0, -0.3, 0.0, 0.45),
    (-5, -28, 0, 0.3, 0.0, 0.45),
    (35, -20, 12, 0.15, 0.0, 0.6),
    (-20, 35, -15, -0.15, 0.0, 0.6),
)


class SimulatedHand:
    """Holds a printed board, or the display itself, in one pose after another. Implements :class:`rig.calibrating.hands.Hands`.

    ``camera`` is where the simulated camera is and how it looks: a hand sees where it holds something. ``size_mm`` is width and
    height of what it holds; it is held so far away that it takes its share of the photo.
    """

    def __init__(
        self, world: World, camera: CameraBody, *, printed: Print | None, size_mm: tuple[float, float]
    ) -> None:
        if camera.pose is None or camera.intrinsics is None:
            raise ConfigError("the simulated camera has no pose; give the scene's camera one")
        self._world = world
        self._camera = camera
        self._printed = printed
        self._size_mm = size_mm
        self.swing_mm = (0.0, 0.0, 0.0)

    def pose(self, number: int, advice: tuple[str, ...]) -> Answer:  # noqa: ARG002  (it holds all of its poses anyway)
        """Hold the next pose; the hand is done when it has held them all."""
        if number >= len(POSES):
            return "done"
        self._world.hold(HeldSheet(self._place(number), self._printed, self.swing_mm))
        return "photo"

    def away(self) -> None:
        """Take the board away."""
        self._world.hold(None)

    def _place(self, number: int) -> ScreenPose:
        about_x, about_y, about_z, across, down, share = POSES[number]
        camera = self._camera
        assert camera.pose is not None, "checked on making"
        assert camera.intrinsics is not None, "checked on making"
        focal = np.array([camera.intrinsics.focal_x_px, camera.intrinsics.focal_y_px])
        size_px = np.array([camera.columns, camera.rows])
        fill_px = share * size_px
        depth_mm = float(np.max(focal * np.array(self._size_mm) / fill_px))
        middle = depth_mm * np.array([*(np.array([across, down]) * size_px / focal), 1.0])
        turn = np.eye(3)
        for axis, angle_deg in enumerate((about_x, about_y, about_z)):
            turn = cv2.Rodrigues(np.radians(angle_deg) * np.eye(3)[axis])[0] @ turn
        world_from_camera = camera.pose.world_from_screen()
        axes = world_from_camera[:3, :3] @ turn
        return ScreenPose(world_from_camera[:3, :3] @ middle + world_from_camera[:3, 3], axes[:, 0], axes[:, 1])
