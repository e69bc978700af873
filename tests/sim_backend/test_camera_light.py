"""The light of a simulated exposure: in proportion to time and sensitivity, and to the aperture's area."""

import numpy as np
import pytest
import simplejpeg

from drivers.protocols import Frame
from sim_backend.camera import DEFAULT_SETTINGS, SimulatedCamera
from sim_backend.clock import SimulatedClock
from sim_backend.photography import Photographer
from sim_backend.scene import load_scene
from sim_backend.world import TankSize, World, WorldState

WHITE = Frame(axis="x", levels=np.full(32, 255, np.uint8))


@pytest.fixture(scope="module")
def photographer() -> Photographer:
    scene = load_scene("semi_ellipsoid").resized(camera_columns=48, display_columns=32)
    # Half of the range, so that twice the light is not clipped.
    return Photographer(scene.model_copy(update={"camera": scene.camera.model_copy(update={"signal": 0.45})}))


def photo(photographer: Photographer, settings: dict[str, str]) -> bytes:
    world = World(clock=SimulatedClock(), tank=TankSize(2.0, 1.0), dark_frame=WHITE, state=WorldState(stage_mm=10.0))
    camera = SimulatedCamera(world, photographer, exposure_s=0.1, download_s=0.1)
    camera.apply_settings(settings)
    camera.expose(timeout_s=1.0)
    return camera.collect(timeout_s=1.0)[0].data


def light(data: bytes) -> float:
    return float(simplejpeg.decode_jpeg(data, colorspace="GRAY").mean())


@pytest.mark.parametrize(
    ("settings", "times"),
    [
        ({"shutter": "1/8"}, 0.5),
        ({"shutter": "0.5"}, 2.0),
        ({"iso": "200"}, 2.0),
        ({"aperture": "16"}, 0.25),  # twice the f-number is a quarter of the area
        ({"shutter": "0.5", "iso": "50"}, 1.0),
    ],
)
def test_the_photo_gets_so_many_times_the_light(
    photographer: Photographer, settings: dict[str, str], times: float
) -> None:
    usual = light(photo(photographer, {}))
    assert usual > 60
    # Rounding and JPEG move the mean of a photo by far less than half a count.
    assert light(photo(photographer, settings)) == pytest.approx(times * usual, abs=0.5)


def test_the_usual_settings_leave_the_photo_as_the_scene_has_it(photographer: Photographer) -> None:
    straight = photographer.photograph(WHITE, stage_position_mm=10.0, wet=False)
    taken = simplejpeg.decode_jpeg(photo(photographer, dict(DEFAULT_SETTINGS)), colorspace="GRAY")
    np.testing.assert_array_equal(taken, simplejpeg.decode_jpeg(straight, colorspace="GRAY"))
