"""What a hand holds before the simulated camera is seen where a pinhole with its lens shows it."""

import cv2
import numpy as np
import pytest
import simplejpeg

from drivers.protocols import Frame
from sim_backend.camera import SimulatedCamera
from sim_backend.clock import SimulatedClock
from sim_backend.held_sheet import HeldSheet, Print
from sim_backend.optics.screen import ScreenPose
from sim_backend.photography import Photographer
from sim_backend.scene import Scene, load_scene
from sim_backend.world import TankSize, World, WorldState

DISTORTION = (-0.2, 0.05, 1e-3, -5e-4, 0.0)
DEPTH_MM = 400.0


@pytest.fixture(scope="module")
def scene() -> Scene:
    base = load_scene("hemisphere").resized(camera_columns=240, display_columns=64)
    camera = {
        "focal_x_px": 300.0,
        "focal_y_px": 310.0,
        "distortion": DISTORTION,
        "position_mm": (0.0, 0.0, -DEPTH_MM),
        "read_noise_electrons": 0.0,
        "full_well_electrons": 1e9,
        "jpeg_quality": 100,
    }
    return Scene.model_validate(base.model_dump() | {"camera": base.camera.model_dump() | camera})


def tilted(angle_deg: float, centre_mm: tuple[float, float, float]) -> ScreenPose:
    """Return a sheet turned about its y axis, its right edge away from the camera."""
    angle = np.radians(angle_deg)
    x_axis = np.array([np.cos(angle), 0.0, np.sin(angle)])
    return ScreenPose(np.array(centre_mm), x_axis, np.array([0.0, 1.0, 0.0]))


def dots() -> Print:
    """Nine white dots of 5 mm on black, 30 mm apart."""
    levels = np.zeros((85, 85), np.uint8)
    for row in (10, 40, 70):
        for column in (10, 40, 70):
            levels[row : row + 5, column : column + 5] = 255
    return Print(levels, pitch_mm=1.0)


def photo_of(scene: Scene, held: HeldSheet, **light: float) -> np.ndarray:
    frame = Frame(axis="x", levels=np.full(scene.display.columns, 255, np.uint8))
    return simplejpeg.decode_jpeg(Photographer(scene).photograph_held(held, frame, **light), "GRAY")[:, :, 0]


def middles(photo: np.ndarray) -> np.ndarray:
    """Return the centroids of the bright dots."""
    count, labels = cv2.connectedComponents((photo > 40).astype(np.uint8))
    found = []
    for number in range(1, count):
        row, column = np.nonzero(cv2.dilate((labels == number).astype(np.uint8), np.ones((5, 5))))
        weight = photo[row, column].astype(float) - 3.0  # the ambient light's hundredth of 255
        found.append((np.average(column, weights=weight), np.average(row, weights=weight)))
    return np.array(found)


@pytest.mark.parametrize("angle_deg", [0.0, 35.0, -35.0])
def test_a_printed_sheet_is_seen_where_opencv_projects_it(scene: Scene, angle_deg: float) -> None:
    pose = tilted(angle_deg, (4.0, -6.0, -20.0))
    place_mm = np.array([(column - 30.0, row - 30.0) for row in (0, 30, 60) for column in (0, 30, 60)])
    in_scene = pose.centre_mm + place_mm[:, :1] * pose.x_axis + place_mm[:, 1:] * pose.y_axis
    in_camera = in_scene - np.array(scene.camera.position_mm)
    matrix = np.array([[300.0, 0, scene.camera.centre_x_px], [0, 310.0, scene.camera.centre_y_px], [0, 0, 1]])
    expected, _ = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), matrix, np.array(DISTORTION))
    found = middles(photo_of(scene, HeldSheet(pose, dots())))
    assert len(found) == 9
    apart = np.linalg.norm(found[:, None] - expected.reshape(1, -1, 2), axis=2)
    # A dot's centroid is off its centre's image by its size squared over the distance; quantisation adds as much.
    assert sorted(apart.argmin(axis=1)) == list(range(9))
    assert apart.min(axis=1).max() < 0.07


def test_a_hand_that_moves_while_the_shutter_is_open_spreads_the_light_and_keeps_its_sum(scene: Scene) -> None:
    pose = tilted(0.0, (0.0, 0.0, 0.0))
    still = photo_of(scene, HeldSheet(pose, dots())).astype(float)
    moved = photo_of(scene, HeldSheet(pose, dots(), swing_mm=(10.0, 0.0, 0.0))).astype(float)
    assert moved.max() < 0.7 * still.max()  # 10 mm spread a dot of 5 mm over three times its width
    assert moved.sum() == pytest.approx(still.sum(), rel=0.02)


def test_the_display_in_a_hand_shows_its_frame(scene: Scene) -> None:
    """At 400 mm a panel 197 mm wide is 300 · 197 / 400 px wide, but for a lens that draws its edges inwards."""
    straight = scene.model_copy(update={"camera": scene.camera.model_copy(update={"distortion": ()})})
    photo = photo_of(straight, HeldSheet(tilted(0.0, (0.0, 0.0, 0.0))))
    middle = photo[photo.shape[0] // 2].astype(float)
    width_px = (middle - 3.0).sum() / (middle.max() - 3.0)
    assert width_px == pytest.approx(300.0 * 64 * straight.display.pitch_mm / DEPTH_MM, abs=0.5)


def test_a_camera_sees_what_is_held_until_it_is_taken_away(scene: Scene) -> None:
    dark = Frame(axis="x", levels=np.zeros(scene.display.columns, np.uint8))
    world = World(
        clock=SimulatedClock(0.0), tank=TankSize(1.0, 1.0), dark_frame=dark, state=WorldState(object_present=False)
    )
    brightness = []
    with SimulatedCamera(world, Photographer(scene), exposure_s=0.0, download_s=0.0) as camera:
        for held in (HeldSheet(tilted(0.0, (0.0, 0.0, 0.0)), dots()), None):
            world.hold(held)
            camera.expose(timeout_s=1.0)
            brightness.append(simplejpeg.decode_jpeg(camera.collect(timeout_s=1.0)[0].data, "GRAY").max())
    assert brightness[0] > 150
    assert brightness[1] < 20
