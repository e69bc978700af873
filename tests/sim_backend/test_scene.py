"""Scenes: loading, sizes, and the objects they hold."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from sim_backend.light_paths import meet_display, pixel_centre_paths
from sim_backend.optics.tracer import trace
from sim_backend.photography import Photographer
from sim_backend.scene import Scene, SceneError, SceneVariation, load_scene, scene_names
from sim_backend.truth import Truth, TruthStatus, compute_truth, save_truth

HEMISPHERE = Path(__file__).parents[2] / "sim_backend" / "scenes" / "hemisphere.toml"


@pytest.fixture(params=scene_names())
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def small_truth(name: str) -> Truth:
    return Photographer(load_scene(name).resized(camera_columns=48)).truth()


def judged(truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    chosen = truth.status == TruthStatus.JUDGED
    assert chosen.mean() > 0.1
    return truth.point_mm[chosen], truth.normal[chosen]


def test_every_built_in_scene_shows_its_object_and_something_beside_it(name: str) -> None:
    scene = load_scene(name)
    assert scene.name == name
    status = small_truth(name).status
    assert (status == TruthStatus.JUDGED).mean() > 0.2
    assert (status == TruthStatus.MISSES_OBJECT).any()


def test_true_points_lie_between_camera_and_display_with_normals_towards_the_display(name: str) -> None:
    scene = load_scene(name)
    point, normal = judged(small_truth(name))
    assert (point[:, 2] > scene.camera.position_mm[2]).all()
    assert (point[:, 2] < min(scene.stage_positions_mm)).all()
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-12)
    if scene.liquid_level_mm is not None:
        assert (point[:, 2] > scene.liquid_level_mm).all()


def test_an_unknown_scene_is_refused_with_the_names_of_those_that_exist() -> None:
    with pytest.raises(SceneError, match=r"no scene 'teapot': choose one of .*hemisphere.*semi_ellipsoid"):
        load_scene("teapot")


def test_a_scene_file_with_a_wrong_field_is_refused_by_its_name(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(HEMISPHERE.read_text().replace("n_object = 1.5195", "n_object = 0.5"))
    with pytest.raises(SceneError, match="n_object: Input should be greater than or equal to 1"):
        load_scene(path)
    path.write_text("name = ")
    with pytest.raises(SceneError, match="is not TOML"):
        load_scene(path)


def test_a_scene_file_is_read_like_a_built_in_scene(tmp_path: Path) -> None:
    path = tmp_path / "dome.toml"
    path.write_text(HEMISPHERE.read_text().replace("27.99", "20.0"))
    assert load_scene(path).specimen.model_dump() == {"kind": "hemisphere", "radius_mm": 20.0}


def test_a_resized_scene_keeps_field_and_panel() -> None:
    scene = load_scene("hemisphere")
    other = scene.resized(camera_columns=64, display_columns=2048)
    assert (other.camera.columns, other.camera.rows) == (64, 64)
    assert (other.display.columns, other.display.rows) == (2048, 1536)
    assert other.display.columns * other.display.pitch_mm == pytest.approx(
        scene.display.columns * scene.display.pitch_mm
    )
    # The left edge of the photo, half a pixel before the first pixel's centre, looks the same way.
    left = (-0.5 - scene.camera.centre_x_px) / scene.camera.focal_x_px
    assert (-0.5 - other.camera.centre_x_px) / other.camera.focal_x_px == pytest.approx(left)


def test_the_stage_carries_the_display_along_its_direction() -> None:
    scene = load_scene("hemisphere")
    first, second = (scene.display_pose_at(place) for place in scene.stage_positions_mm)
    np.testing.assert_allclose(second.centre_mm - first.centre_mm, [0, 0, 40])
    np.testing.assert_allclose(first.away(), [0, 0, 1])


def test_a_hemisphere_has_its_points_on_the_sphere_and_radial_normals() -> None:
    point, normal = judged(small_truth("hemisphere"))
    np.testing.assert_allclose(np.linalg.norm(point, axis=1), 27.99, atol=1e-9)
    np.testing.assert_allclose(normal, point / 27.99, atol=1e-9)


def test_the_concave_cone_has_the_slope_of_its_height_over_its_radius() -> None:
    point, normal = judged(small_truth("concave_cone"))
    radius = np.hypot(point[:, 0], point[:, 1])
    inner = radius < 4.9
    # Apex 4 inside the face, and 10 wide there: z = -4 + 0.4 r. The normal leans towards the axis.
    np.testing.assert_allclose(point[inner, 2], -4 + 0.4 * radius[inner], atol=1e-9)
    np.testing.assert_allclose(normal[inner, 2], 1 / np.hypot(1, 0.4), atol=1e-9)
    assert (np.sum(normal[inner, :2] * point[inner, :2], axis=1) < 0).all()


def test_the_ornament_shows_six_planes() -> None:
    scene = load_scene("ornament")
    _, normal = judged(small_truth("ornament"))
    tilt = np.degrees(np.arccos(normal[:, 2]))
    found = np.unique(np.round(tilt, 6))
    np.testing.assert_allclose(found, sorted(scene.specimen.facet_tilts_deg), atol=1e-6)


def test_the_bottle_is_seen_through_its_air_to_the_far_side_of_its_outer_wall() -> None:
    point, normal = judged(small_truth("bottle"))
    side = np.abs(point[:, 1]) < 15
    np.testing.assert_allclose(np.hypot(point[side, 0], point[side, 2]), 14.18, atol=1e-9)
    np.testing.assert_allclose(normal[side, 1], 0, atol=1e-12)


def test_the_thin_shell_bulges_towards_the_display() -> None:
    point, normal = judged(small_truth("thin_shell"))
    np.testing.assert_allclose(np.linalg.norm(point, axis=1), 10, atol=1e-9)
    np.testing.assert_allclose(normal, point / 10, atol=1e-9)


def test_the_padding_of_the_thin_cone_moves_no_normal() -> None:
    scene = load_scene("thin_cone")
    padded = scene.model_copy(update={"specimen": scene.specimen.model_copy(update={"padding_mm": 2.0})})
    for each in (scene, padded):
        _, normal = judged(Photographer(each.resized(camera_columns=48)).truth())
        slope = np.degrees(np.arccos(normal[:, 2]))
        # Points on the padding's rim have normals at right angles to z.
        np.testing.assert_allclose(slope[slope < 80], np.degrees(np.arctan(1 / 4)), atol=1e-6)


def test_a_round_plate_shows_its_rings() -> None:
    point, normal = judged(small_truth("plate_round"))
    radius = np.hypot(point[:, 0], point[:, 1])
    wave = 2 * np.pi / 40
    np.testing.assert_allclose(point[:, 2], 3 - 0.3 * (1 - np.cos(wave * radius)), atol=1e-9)
    # The radial part of the normal over its z part is minus the slope of the profile.
    tilt = np.sum(normal[:, :2] * point[:, :2], axis=1) / radius / normal[:, 2]
    np.testing.assert_allclose(tilt, 0.3 * wave * np.sin(wave * radius), atol=1e-9)


def test_a_fish_plate_has_the_length_and_width_of_the_fish() -> None:
    point, _ = judged(Photographer(load_scene("plate_fish")).truth())
    # A pixel sees 0.8 mm.
    assert np.ptp(point[:, 0]) == pytest.approx(256, abs=1.6)
    assert np.ptp(point[:, 1]) == pytest.approx(207, abs=1.6)


def wedge(**specimen: object) -> Scene:
    described = tomllib.loads(HEMISPHERE.read_text())
    described["camera"] |= {"columns": 48, "rows": 48, "centre_x_px": 23.5, "centre_y_px": 23.5, "focal_x_px": 2100}
    described["specimen"] = {"side_mm": 8.0, "thickness_mm": 4.0, "lean_deg": 20.0, **specimen}
    return Scene.model_validate(described)


def test_a_rippled_wedge_is_a_sine_on_a_leaning_plane() -> None:
    truth = compute_truth(wedge(kind="wedge_rippled", amplitude_mm=0.05, wavelength_mm=1.2))
    point, normal = judged(truth)
    wave = 2 * np.pi / 1.2
    height = 4 + np.tan(np.radians(20)) * point[:, 1] + 0.05 * np.sin(wave * point[:, 0])
    np.testing.assert_allclose(point[:, 2], height, atol=1e-9)
    np.testing.assert_allclose(normal[:, 0] / normal[:, 2], -0.05 * wave * np.cos(wave * point[:, 0]), atol=1e-9)
    np.testing.assert_allclose(normal[:, 1] / normal[:, 2], -np.tan(np.radians(20)), atol=1e-9)


def test_a_stepped_wedge_deviates_light_like_a_prism_and_is_higher_on_the_right() -> None:
    scene = wedge(kind="wedge_stepped", step_mm=0.5)
    point, normal = judged(compute_truth(scene))
    over = point[:, 2] - 4 - np.tan(np.radians(20)) * point[:, 1]
    face = normal[:, 2] > 0.5
    np.testing.assert_allclose(over[face], np.where(point[face, 0] > 0, 0.25, -0.25), atol=1e-9)
    # A ray along z meets the face at 20°: n sin 20° = sin(20° + deviation), towards the thick side.
    axial = trace(scene.world(wet=False), np.array([[1.0, 0.0, -5.0]]), np.array([[0.0, 0.0, 1.0]])).direction[0]
    deviation = np.arcsin(scene.n_object * np.sin(np.radians(20))) - np.radians(20)
    np.testing.assert_allclose(axial, [0, np.sin(deviation), np.cos(deviation)], atol=1e-12)


def test_a_wedge_that_would_be_thinner_than_nothing_is_refused_with_what_it_needs() -> None:
    with pytest.raises(ValueError, match=r"thin side would be at -.*give more than 1\.506"):
        wedge(kind="wedge_rippled", amplitude_mm=0.05, wavelength_mm=1.2, thickness_mm=1.0)


def test_glass_by_name_has_the_index_of_the_displays_colour() -> None:
    scene = load_scene("hemisphere_white")
    # Schott's data sheet gives 1.51872 at the mercury line 546.07 nm; 530 nm is a little higher.
    assert 1.51872 < scene.n_object < 1.521
    assert scene.n_liquid == pytest.approx(1.3355, abs=1e-9)
    red, green, blue = scene.spectrum()
    assert red.n_object < green.n_object < blue.n_object
    assert red.weight + green.weight + blue.weight == pytest.approx(1)
    one_colour = scene.display.model_copy(update={"primary": "green"})
    assert len(scene.model_copy(update={"display": one_colour}).spectrum()) == 1


def test_a_glass_nobody_knows_or_with_another_index_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(HEMISPHERE.read_text().replace("n_object = 1.5195", 'glass = "jelly"'))
    with pytest.raises(SceneError, match="glass 'jelly' is not one of N-BK7"):
        load_scene(path)
    path.write_text(HEMISPHERE.read_text().replace("n_object = 1.5195", 'glass = "N-BK7"\nn_object = 1.6'))
    with pytest.raises(SceneError, match="n_object follows from glass 'N-BK7'"):
        load_scene(path)


@pytest.mark.parametrize("name", ["hemisphere", "concave_cone", "ornament", "bottle", "semi_ellipsoid"])
def test_the_paths_in_air_and_liquid_cross_at_the_true_point_and_give_its_normal(name: str) -> None:
    scene = load_scene(name).resized(camera_columns=48)
    truth = Photographer(scene).truth()
    judged = (truth.status == TruthStatus.JUDGED).ravel()
    point, normal = truth.point_mm.reshape(-1, 3)[judged], truth.normal.reshape(-1, 3)[judged]
    directions = []
    for wet in (False, True):
        paths = pixel_centre_paths(scene, scene.world(wet=wet))
        ends = []
        for position in scene.stage_positions_mm:
            hits = meet_display(scene, position, paths.origin, paths.direction, paths.n)
            x_mm = (hits.x_mm[judged] + 0.5 - scene.display.columns / 2) * scene.display.pitch_mm
            y_mm = (hits.y_mm[judged] + 0.5 - scene.display.rows / 2) * scene.display.pitch_mm
            ends.append(np.column_stack([x_mm, y_mm, np.full(len(x_mm), position)]))
        direction = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0], axis=1)[:, None]
        # The true point lies on the line through both places on the display.
        np.testing.assert_allclose(np.cross(point - ends[0], direction), 0, atol=1e-8)
        directions.append(direction)
    # Snell's law in vector form: n_liquid U - n_air V is along the normal (paper, section 5).
    along = scene.n_liquid * directions[1] - scene.n_air * directions[0]
    np.testing.assert_allclose(along / np.linalg.norm(along, axis=1)[:, None], normal, atol=1e-8)


def test_the_scene_of_the_guide_can_be_photographed(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "write-a-scene.md").read_text("utf-8")
    whole, *additions = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    path = tmp_path / "mine.toml"
    path.write_text(whole, "utf-8")
    assert load_scene(path).display.cover_glass is not None
    everything = tomllib.loads(whole)
    for addition in additions:
        for table, values in tomllib.loads(addition).items():
            everything[table] = everything.get(table, {}) | values
    scene = Scene.model_validate(everything).resized(camera_columns=48)
    assert scene.index_variation is not None
    assert scene.display.changes_with_time
    assert scene.marks is not None
    assert (Photographer(scene).truth().status == TruthStatus.JUDGED).any()


def test_glass_of_varying_index_leaves_the_true_points_on_the_surface() -> None:
    scene = load_scene("hemisphere").resized(camera_columns=48)
    plain = Photographer(scene).truth()
    varied = scene.model_copy(update={"index_variation": SceneVariation(radial_per_mm2=-2e-5, step_mm=0.5)})
    truth = Photographer(varied).truth()
    both = (plain.status == TruthStatus.JUDGED) & (truth.status == TruthStatus.JUDGED)
    point = truth.point_mm[both]
    np.testing.assert_allclose(np.linalg.norm(point, axis=1), 27.99, atol=1e-9)
    # An index that falls outwards gathers light, as the camera sees it: rays turn towards the axis. Over the path of
    # up to 28 mm a ray at r = 10 turns by 2 · 2e-5 · 10 / 1.52 a millimetre and moves by half of that times 28².
    inward = np.hypot(plain.point_mm[both][:, 0], plain.point_mm[both][:, 1]) - np.hypot(point[:, 0], point[:, 1])
    assert 0.03 < inward.max() < 2 * 2e-5 * 16 / 1.52 * 28**2 / 2


def test_a_thin_scene_cannot_be_photographed_wet() -> None:
    with pytest.raises(SceneError, match="has no liquid"):
        load_scene("thin_cone").world(wet=True)


def test_the_truth_file_holds_points_normals_and_status(tmp_path: Path) -> None:
    truth = small_truth("hemisphere")
    save_truth(truth, tmp_path / "truth.npz")
    with np.load(tmp_path / "truth.npz") as stored:
        sets = [f"pos{position}_{condition}" for position in (0, 1) for condition in ("air", "liquid")]
        assert sorted(stored) == ["normal", *(f"place_px_{name}" for name in sets), "point_mm", "status"]
        np.testing.assert_array_equal(stored["point_mm"], truth.point_mm)
        assert np.isnan(stored["point_mm"][stored["status"] != 0]).all()


def test_true_places_beside_the_object_are_where_the_pinhole_ray_meets_the_display() -> None:
    scene = load_scene("hemisphere").resized(camera_columns=24, display_columns=None)
    truth = compute_truth(scene)
    camera, panel = scene.camera, scene.display
    row, column = np.nonzero(
        (truth.status == TruthStatus.MISSES_OBJECT) & np.isfinite(truth.place_px["pos1_air"][..., 0])
    )
    assert len(row) > 4
    depth_mm = scene.stage_positions_mm[1] - camera.position_mm[2]
    x_mm = camera.position_mm[0] + depth_mm * (column - camera.centre_x_px) / camera.focal_x_px
    y_mm = camera.position_mm[1] + depth_mm * (row - camera.centre_y_px) / camera.focal_y_px
    place = np.stack(
        [x_mm / panel.pitch_mm + (panel.columns - 1) / 2, y_mm / panel.pitch_mm + (panel.rows - 1) / 2], axis=1
    )
    np.testing.assert_allclose(truth.place_px["pos1_air"][row, column], place, atol=1e-9)
