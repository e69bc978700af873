"""What filling the tank changes beside the medium: bubbles, an object that floats up, a slot that the liquid enters."""

import numpy as np
import pytest
from pydantic import ValidationError

from sim_backend.display_bubbles import display_bubbles, through_display_bubbles
from sim_backend.disturbance import Disturbance
from sim_backend.light_paths import SubRays
from sim_backend.optics.tracer import trace
from sim_backend.photography import Photographer
from sim_backend.scene import Scene, WhenFilled, load_scene
from sim_backend.specimens import SlottedHemisphere
from sim_backend.truth import Truth, TruthStatus, compute_truth

N_WATER = 1.3355
RADIUS_MM = 2.0


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("hemisphere").resized(camera_columns=48)


def filled(scene: Scene, **changes: object) -> Scene:
    return scene.model_copy(update={"when_filled": WhenFilled.model_validate(changes)})


def wet_places(truth: Truth) -> np.ndarray:
    return np.stack([truth.place_px[name] for name in ("pos0_liquid", "pos1_liquid")])


def straight_down(offset_mm: list[float]) -> SubRays:
    count = len(offset_mm)
    return SubRays(
        1,
        count,
        np.column_stack([offset_mm, np.zeros(count), np.full(count, 30.0)]),
        np.tile([0.0, 0.0, 1.0], (count, 1)),
        np.full(count, N_WATER),
        np.ones(count, np.float32),
        np.full(count, 7),
    )


def test_a_bubble_on_the_display_turns_light_like_a_ball_of_air(scene: Scene) -> None:
    # Each side turns a ray at height h by asin(n h / R) − asin(h / R), away from the axis.
    height = np.array([0.3, 0.9, 1.4])
    bent = through_display_bubbles(
        filled(scene, display_bubbles_mm=[[0, 0, RADIUS_MM]]), straight_down([*height]), 53.0
    )
    turn = 2 * (np.arcsin(N_WATER * height / RADIUS_MM) - np.arcsin(height / RADIUS_MM))
    np.testing.assert_allclose(np.arcsin(bent.direction[:, 0]), turn, atol=1e-10)
    assert (bent.transmission < 1).all()
    assert not np.isin(bent.route, 7).any()


def test_a_bubble_on_the_display_mirrors_what_meets_it_too_flat_and_leaves_the_rest_alone(scene: Scene) -> None:
    # Beyond sin i = 1 / n a ray is thrown back by π − 2 i; beside the bubble it goes on as it was.
    bent = through_display_bubbles(
        filled(scene, display_bubbles_mm=[[0, 0, RADIUS_MM]]), straight_down([1.8, 2.1]), 53.0
    )
    turn = np.pi - 2 * np.arcsin(1.8 / RADIUS_MM)
    np.testing.assert_allclose(bent.direction[0], [np.sin(turn), 0, np.cos(turn)], atol=1e-10)
    np.testing.assert_array_equal(bent.direction[1], [0, 0, 1])
    assert (bent.transmission[1], bent.route[1]) == (1.0, 7)


def test_a_bubble_on_the_display_rides_on_its_glass_with_the_stage(scene: Scene) -> None:
    both = filled(scene, display_bubbles_mm=[[5, -3, RADIUS_MM]])
    for stage_mm in scene.stage_positions_mm:
        (ball,) = display_bubbles(both, stage_mm)
        # Touches z = stage at (5, −3): there the function is nought, and its gradient points at the display.
        touch = np.array([[5.0, -3.0, stage_mm]])
        assert ball.value(touch)[0] == pytest.approx(0.0, abs=1e-9)
        np.testing.assert_allclose(ball.gradient(touch)[0], [0, 0, 2 * RADIUS_MM], atol=1e-9)


def test_light_through_a_bubble_round_the_dome_leaves_by_the_law_of_concentric_shells(scene: Scene) -> None:
    # n r sin θ is kept from shell to shell: glass to 27.99, air to 40, water beyond. Each boundary turns the ray.
    radius, outer, height = 27.99, 40.0, 7.0
    world = filled(scene, bubbles_mm=[[0.0, 0.0, 0.0, outer]]).world(wet=True)
    paths = trace(world, np.array([[height, 0, -420.0]]), np.array([[0.0, 0, 1.0]]))
    kept = scene.n_object * height
    glass, air, at_water, water = (
        np.arcsin(s) for s in (height / radius, kept / radius, kept / outer, kept / outer / N_WATER)
    )
    # The path leans towards the axis.
    assert np.arcsin(-paths.direction[0, 0]) == pytest.approx((air - glass) + (water - at_water), abs=1e-10)
    assert paths.n[0] == N_WATER
    np.testing.assert_allclose(paths.exit_point[0], [height, 0, np.sqrt(radius**2 - height**2)], atol=1e-9)


def test_truth_and_dry_sets_know_nothing_of_what_filling_changed(scene: Scene) -> None:
    plain, found = (
        compute_truth(one)
        for one in (scene, filled(scene, object_shift_mm=[0.5, 0, -0.2], bubbles_mm=[[0, 0, 29, 1.5]]))
    )
    np.testing.assert_array_equal(found.point_mm, plain.point_mm)
    np.testing.assert_array_equal(found.status, plain.status)
    np.testing.assert_array_equal(found.place_px["pos0_air"], plain.place_px["pos0_air"])
    assert np.nanmax(np.abs(wet_places(found) - wet_places(plain))) > 0.1


def test_an_object_that_rose_is_seen_as_if_all_else_had_sunk(scene: Scene) -> None:
    rise_mm = 0.4
    x_mm, y_mm, z_mm = scene.camera.position_mm
    sunk = scene.model_copy(
        update={
            "liquid_level_mm": scene.liquid_level_mm + rise_mm,
            "stage_positions_mm": tuple(place + rise_mm for place in scene.stage_positions_mm),
            "camera": scene.camera.model_copy(update={"position_mm": (x_mm, y_mm, z_mm + rise_mm)}),
        }
    )
    risen = compute_truth(filled(scene, object_shift_mm=[0, 0, -rise_mm]))
    np.testing.assert_allclose(wet_places(risen), wet_places(compute_truth(sunk)), atol=1e-6)


def test_photos_show_the_object_where_filling_moved_it_and_the_dry_ones_where_it_was(scene: Scene) -> None:
    moved, still = Photographer(filled(scene, object_shift_mm=[0.4, -0.3, 0])), Photographer(scene)
    place = {"stage_position_mm": 53.0, "wet": True}
    pushed = still.pixel_coordinates(**place, disturbance=Disturbance(object_shift_mm=(0.4, -0.3)))
    np.testing.assert_allclose(moved.pixel_coordinates(**place), pushed, atol=1e-9)
    dry = {"stage_position_mm": 53.0, "wet": False}
    np.testing.assert_array_equal(moved.pixel_coordinates(**dry), still.pixel_coordinates(**dry))


def slotted(scene: Scene, tilt_deg: float) -> Scene:
    part = SlottedHemisphere(radius_mm=27.99, slot_mm=2.0, slot_depth_mm=8.0, slot_tilt_deg=tilt_deg)
    return scene.model_copy(update={"specimen": part})


@pytest.mark.parametrize(("wet", "n_gap"), [(False, 1.0), (True, N_WATER)])
def test_light_crosses_a_slot_by_the_shift_of_a_plane_gap_and_enters_the_glass_again(
    scene: Scene, wet: bool, n_gap: float
) -> None:
    # A gap of thickness t moves a ray by t sin(a − g) / cos g across itself: a in the glass, g in the gap (Snell).
    tilt = np.radians(10.0)
    origin, direction = np.array([[9.0, 0, -420.0], [-9.0, 0, -420.0]]), np.tile([0.0, 0, 1.0], (2, 1))
    paths = trace(slotted(scene, 10.0).world(wet=wet), origin, direction)
    gap = np.arcsin(scene.n_object * np.sin(tilt) / n_gap)
    # The face rises with x: its normal leans to −x, light in the thinner gap bends away from the normal, to +x.
    moved = 2.0 * np.sin(gap - tilt) / np.cos(gap)
    np.testing.assert_allclose(paths.exit_point[0, 0], 9.0 + moved, atol=1e-9)
    np.testing.assert_allclose(paths.exit_point[1, 0], -9.0, atol=1e-9)
    np.testing.assert_array_equal(paths.exits, [2, 1])


def test_pixels_whose_light_enters_again_have_no_true_point_and_say_why(scene: Scene) -> None:
    found = compute_truth(slotted(scene, 10.0))
    middle = np.s_[20:28]
    assert (found.status[middle, 30:34] == TruthStatus.RE_ENTERS).all()
    assert (found.status[middle, 14:18] == TruthStatus.JUDGED).all()
    assert np.isnan(found.point_mm[24, 32]).all()


def test_a_thin_object_has_no_tank_to_fill() -> None:
    fields = load_scene("thin_cone").model_dump() | {"when_filled": {"bubbles_mm": [[0, 0, 0, 1]]}}
    with pytest.raises(ValidationError, match="belongs to the method 'liquid'"):
        Scene.model_validate(fields)
