"""What disturbs a scene moves light as the laws say, and a scene that nobody disturbs is photographed as ever."""

import numpy as np
import pytest
import simplejpeg

from drivers.protocols import Frame
from sim_backend.clock import SimulatedClock
from sim_backend.disturbance import QUIET, ROUTE_THROUGH_SURFACE, Disturbance, rippled, surface_slope
from sim_backend.light_paths import SubRays
from sim_backend.marks import marks_seen_px, with_marks
from sim_backend.photography import Photographer
from sim_backend.scene import Scene, load_scene
from sim_backend.unrest import Ripples
from sim_backend.world import TankSize, World, WorldState

STAGE_MM = 53.0
GREY = Frame("x", np.full(512, 200, np.uint8))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("hemisphere").resized(camera_columns=64)


@pytest.fixture(scope="module")
def photographer(scene: Scene) -> Photographer:
    return Photographer(scene)


def seen(photographer: Photographer, *, wet: bool = False, object_present: bool = True, **disturbance) -> np.ndarray:
    return photographer.pixel_coordinates(
        stage_position_mm=STAGE_MM, wet=wet, object_present=object_present, disturbance=Disturbance(**disturbance)
    )


def test_a_scene_at_rest_is_photographed_to_the_same_byte(photographer: Photographer) -> None:
    place = {"stage_position_mm": STAGE_MM, "wet": True}
    assert photographer.photograph(GREY, **place) == photographer.photograph(GREY, **place, disturbance=QUIET)


def test_a_display_that_slipped_shows_every_pixel_another_place(scene: Scene, photographer: Photographer) -> None:
    for wet in (False, True):
        moved = seen(photographer, wet=wet, display_shift_mm=(0.3, -0.2)) - seen(photographer, wet=wet)
        inner = moved[np.isfinite(moved).all(axis=2)]
        # Away from the panel's edge, where a part of a pixel's light is lost on one side only.
        assert np.median(inner, axis=0) == pytest.approx([-0.3 / scene.display.pitch_mm, 0.2 / scene.display.pitch_mm])


def test_a_camera_that_moved_sees_the_bare_display_from_elsewhere(scene: Scene, photographer: Photographer) -> None:
    moved = seen(photographer, object_present=False, camera_shift_mm=(0.5, 0.0, 0.0)) - seen(
        photographer, object_present=False
    )
    np.testing.assert_allclose(moved[24:40, 24:40, 0], 0.5 / scene.display.pitch_mm, rtol=1e-9)
    np.testing.assert_allclose(moved[24:40, 24:40, 1], 0.0, atol=1e-9)


@pytest.mark.parametrize("wet", [False, True])
def test_moving_the_object_is_moving_everything_else_the_other_way(photographer: Photographer, wet: bool) -> None:
    by_object = seen(photographer, wet=wet, object_shift_mm=(0.4, -0.3))
    by_the_rest = seen(photographer, wet=wet, camera_shift_mm=(-0.4, 0.3, 0.0), display_shift_mm=(-0.4, 0.3))
    # One traces in the object's frame, the other in the room's: the same rays to rounding, away from grazing ones.
    assert np.nanmedian(np.abs(by_object - by_the_rest)) < 1e-9
    through = np.s_[24:40, 24:40, 0]
    assert np.nanmax(np.abs(by_object - seen(photographer, wet=wet))[through]) > 0.1


def test_a_display_that_dims_sends_that_share_of_its_light(photographer: Photographer) -> None:
    place = {"stage_position_mm": STAGE_MM, "wet": False}
    before, after = (
        photographer.expected(GREY, **place, disturbance=Disturbance(light=light)) - 0.01 * 255 for light in (1.0, 0.95)
    )
    np.testing.assert_allclose(after, 0.95 * before, atol=1e-3)


def upright_rays(count: int) -> SubRays:
    origin = np.column_stack([np.linspace(-30, 30, count), np.zeros(count), np.full(count, 1.0)])
    return SubRays(
        1,
        count,
        origin,
        np.tile([0.0, 0.0, 1.0], (count, 1)),
        np.full(count, 1.33),
        np.ones(count, np.float32),
        np.full(count, ROUTE_THROUGH_SURFACE),
    )


def test_a_sloping_surface_turns_an_upright_ray_by_the_slope_less_its_refraction() -> None:
    # Far away the camera's rays are upright. Slope s: incidence s, refraction s / n, so the ray turns by s (1 − 1/n).
    rays = upright_rays(41)
    disturbance = Disturbance(ripple_slope=0.003, ripple_time_s=0.7)
    bent = rippled(rays, disturbance, camera_mm=np.array([0.0, 0.0, -1e9]), n_air=1.0)
    slopes = surface_slope(rays.origin[:, 0], rays.origin[:, 1], slope=0.003, time_s=0.7)
    # Where the surface sinks along x (z grows), the liquid is a prism with its thick side the other way, and bends light there.
    turned = bent.direction[:, :2] / bent.direction[:, 2:]
    np.testing.assert_allclose(turned, -slopes * (1 - 1 / 1.33), atol=1e-7)
    assert np.abs(slopes).max() > 1e-3


def test_ripples_leave_alone_what_is_seen_through_the_object(photographer: Photographer) -> None:
    still = seen(photographer, wet=True)
    moved = np.hypot(*np.moveaxis(seen(photographer, wet=True, ripple_slope=0.01, ripple_time_s=1.0) - still, 2, 0))
    assert np.nanmedian(moved[28:36, 28:36]) < 1e-9
    assert np.nanmedian(moved[:4, :4]) > 0.05
    dry = seen(photographer, ripple_slope=0.01, ripple_time_s=1.0) - seen(photographer)
    assert np.nanmax(np.abs(dry)) == 0


def test_the_surface_is_nowhere_steeper_than_said() -> None:
    x, y = np.meshgrid(np.linspace(-50, 50, 101), np.linspace(-50, 50, 101))
    slopes = surface_slope(x.ravel(), y.ravel(), slope=0.01, time_s=3.3)
    assert np.hypot(slopes[:, 0], slopes[:, 1]).max() <= 0.01 + 1e-12


def test_marks_cover_their_squares_and_follow_the_holder(scene: Scene) -> None:
    marked = with_marks(scene.resized(camera_columns=320))
    marks, camera = marked.marks, marked.camera
    photographer = Photographer(marked)
    dark = Frame("x", np.zeros(512, np.uint8))
    place = {"stage_position_mm": STAGE_MM, "wet": True}
    _, _, right, bottom = (round(edge) for edge in marks_seen_px(marked)[0])
    window = np.s_[: bottom + 6, : right + 6]
    row, column = np.indices((camera.rows, camera.columns))

    def centre(**disturbance) -> np.ndarray:
        photo = photographer.expected(dark, **place, disturbance=Disturbance(**disturbance)) - 0.01 * 255
        return np.array([(photo * axis)[window].sum() / photo[window].sum() for axis in (column, row)])

    # The rings' centre of light is the square's centre; the camera sees it f / Z as large.
    away_mm = marks.height_mm - camera.position_mm[2]
    expected = np.array(marks.centres_mm[0]) * camera.focal_x_px / away_mm + camera.centre_x_px
    np.testing.assert_allclose(centre(), expected, atol=0.02)
    moved = centre(object_shift_mm=(0.5, 0.0)) - centre()
    np.testing.assert_allclose(moved, [0.5 * camera.focal_x_px / away_mm, 0.0], atol=0.02)
    on_the_rim = marked.model_copy(update={"marks": marks.model_copy(update={"fixed_to": "rim"})})
    stayed = Photographer(on_the_rim).expected(dark, **place, disturbance=Disturbance(object_shift_mm=(0.5, 0.0)))
    assert stayed[window].sum() == pytest.approx(photographer.expected(dark, **place)[window].sum(), rel=1e-4)


def test_marks_hide_the_display_whatever_it_shows(scene: Scene) -> None:
    marked = with_marks(scene.resized(camera_columns=320))
    photographer = Photographer(marked)
    left, top, right, bottom = (round(edge) for edge in marks_seen_px(marked)[3])
    window = np.s_[top + 2 : bottom - 1, left + 2 : right - 1]
    dark, lit = (
        photographer.expected(Frame("x", np.full(512, level, np.uint8)), stage_position_mm=STAGE_MM, wet=False)
        for level in (0, 255)
    )
    np.testing.assert_array_equal(dark[window], lit[window])


def world_with_water() -> World:
    dark = Frame("x", np.zeros(8, np.uint8))
    state = WorldState(reservoir_ml=1000.0)
    return World(clock=SimulatedClock(), tank=TankSize(1000.0, 500.0), dark_frame=dark, state=state)


def test_ripples_begin_when_the_flow_ends_and_are_gone_in_time() -> None:
    world = world_with_water()
    world.unrest.ripple_after_flows(Ripples(slope=0.02, lasts_s=40.0))
    assert world.look().disturbance == QUIET
    world.start_flow("fill", rate_ml_per_s=50.0, volume_ml=500.0, max_run_s=60.0)
    world.clock.sleep_s(10.0 + 8.0)  # 10 s of flow
    seen = world.look().disturbance
    # exp(-5 · 8 / 40)
    assert seen.ripple_slope == pytest.approx(0.02 * np.exp(-1.0))
    assert seen.ripple_time_s == pytest.approx(8.0)
    world.clock.sleep_s(32.0)
    assert world.look().disturbance == QUIET


def test_photos_have_noise_of_their_own_when_asked(photographer: Photographer) -> None:
    world = world_with_water()
    assert world.look().disturbance == world.look().disturbance
    world.unrest.renew_noise()
    first, second = (
        simplejpeg.decode_jpeg(
            photographer.photograph(GREY, stage_position_mm=STAGE_MM, wet=False, disturbance=world.look().disturbance),
            "GRAY",
        ).astype(float)
        for _ in range(2)
    )
    assert (second - first).std() > 0.5
    assert abs((second - first).mean()) < 0.1
