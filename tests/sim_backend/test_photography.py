"""Photos: what each pixel gathers, noise, and repetition to the byte."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import simplejpeg

from drivers.protocols import Frame, Patch
from sim_backend.footprint import axis_matrix, middles_of_light, trapezoid_share
from sim_backend.light_paths import ScreenMap, screen_map, trace_sub_rays
from sim_backend.photography import Photographer
from sim_backend.scene import Scene, SceneDisplay, load_scene
from sim_backend.sensor import noisy_grey, normal_noise


def small_scene(name: str = "semi_ellipsoid") -> Scene:
    return load_scene(name).resized(camera_columns=64, display_columns=96)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return small_scene()


@pytest.fixture(scope="module")
def photographer(scene: Scene) -> Photographer:
    return Photographer(scene)


def stripe(place: int, count: int, width: int = 2) -> np.ndarray:
    levels = np.zeros(count, np.uint8)
    levels[place : place + width] = 255
    return levels


def test_a_photo_repeats_to_the_byte_also_in_another_photographer(scene: Scene, photographer: Photographer) -> None:
    frame = Frame("x", stripe(40, 96))
    first = photographer.photograph(frame, stage_position_mm=10.0, wet=True)
    assert photographer.photograph(frame, stage_position_mm=10.0, wet=True) == first
    assert Photographer(scene).photograph(frame, stage_position_mm=10.0, wet=True) == first


def test_every_condition_frame_and_seed_has_noise_of_its_own(scene: Scene, photographer: Photographer) -> None:
    dark = Frame("x", np.zeros(96, np.uint8))
    other_seed = Photographer(scene.model_copy(update={"seed": 2}))
    photos = {
        photographer.photograph(dark, stage_position_mm=10.0, wet=True),
        photographer.photograph(dark, stage_position_mm=10.0, wet=False),
        photographer.photograph(dark, stage_position_mm=20.0, wet=True),
        photographer.photograph(dark, stage_position_mm=10.0, wet=True, object_present=False),
        photographer.photograph(Frame("y", np.zeros(96, np.uint8)), stage_position_mm=10.0, wet=True),
        other_seed.photograph(dark, stage_position_mm=10.0, wet=True),
    }
    assert len(photos) == 6


def test_photos_taken_from_several_threads_are_those_taken_in_turn(scene: Scene) -> None:
    frames = [Frame(axis, stripe(place, 96)) for axis in ("x", "y") for place in range(20, 60, 10)]

    def take(photographer: Photographer, frame: Frame) -> bytes:
        return photographer.photograph(frame, stage_position_mm=20.0, wet=False)

    alone, shared = Photographer(scene), Photographer(scene)
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda frame: take(shared, frame), frames))
    assert together == [take(alone, frame) for frame in frames]


def test_stripes_that_cover_the_display_add_up_to_white(photographer: Photographer) -> None:
    ambient = 0.01 * 255
    white = photographer.expected(Frame("x", np.full(96, 255, np.uint8)), stage_position_mm=10.0, wet=True) - ambient
    for axis in ("x", "y"):
        parts = [
            photographer.expected(Frame(axis, stripe(place, 96)), stage_position_mm=10.0, wet=True) - ambient
            for place in range(0, 96, 2)
        ]
        # float32 sums of 48 photos of up to 230 levels.
        np.testing.assert_allclose(np.sum(parts, axis=0), white, atol=0.01)


def test_a_whole_image_of_a_stripe_looks_like_the_stripe(photographer: Photographer) -> None:
    levels = stripe(50, 96, 3)
    image = np.broadcast_to(levels, (96, 96)).copy()
    by_axis = photographer.expected(Frame("x", levels), stage_position_mm=10.0, wet=False)
    by_image = photographer.expected(Frame(image=image), stage_position_mm=10.0, wet=False)
    # The image is sampled at 8 places across a pixel: an edge is placed to 1/16 of the pixel's share.
    assert np.abs(by_axis - by_image).max() < 230 / 16 + 1
    assert np.abs(by_axis - by_image).mean() < 0.5


def test_patches_drawn_on_a_stripe_look_like_the_image_of_both(photographer: Photographer) -> None:
    rng = np.random.default_rng(3)
    patches = (
        Patch(40, 30, rng.integers(0, 256, (12, 20), np.uint8)),
        Patch(85, 90, np.full((10, 20), 200, np.uint8)),
        Patch(44, 33, np.full((4, 4), 255, np.uint8)),
    )
    levels = stripe(45, 96, 4)
    image = np.broadcast_to(levels, (96, 96)).copy()
    image[30:42, 40:60] = patches[0].levels
    image[90:, 85:] = 200
    image[33:37, 44:48] = 255
    both = photographer.expected(Frame("x", levels, patches=patches), stage_position_mm=10.0, wet=True)
    whole = photographer.expected(Frame(image=image), stage_position_mm=10.0, wet=True)
    assert np.abs(both - whole).mean() < 0.5
    by_image = photographer.expected(
        Frame(image=np.broadcast_to(levels, (96, 96)).copy(), patches=patches), stage_position_mm=10.0, wet=True
    )
    np.testing.assert_allclose(by_image, whole, atol=1e-3)


def test_the_mean_place_of_a_sweep_is_the_mean_place_that_a_pixel_sees(photographer: Photographer) -> None:
    places = np.arange(96)
    total, moment = 0.0, 0.0
    for place in places:
        light = photographer.expected(Frame("x", stripe(int(place), 96, 1)), stage_position_mm=10.0, wet=True) - 2.55
        total, moment = total + light, moment + light * place
    column = photographer.pixel_coordinates(stage_position_mm=10.0, wet=True)[..., 0]
    sound = (photographer.truth().status == 0) & (total > 150)
    # A sweep sees whole device pixels. That moves a place by up to half of one, and points at random phases by
    # 1 / √12 = 0.29; over a footprint about a device pixel wide (as here) most of it evens out.
    difference = (moment / total - column)[sound]
    assert np.abs(difference).max() < 0.5
    assert difference.std() < 0.29 / 2
    assert abs(difference.mean()) < 0.002


@pytest.mark.parametrize(("wide", "narrow"), [(1.0, 1.0), (3.0, 0.5), (2.0, 1e-6)])
def test_the_share_of_a_trapezoid_is_the_integral_of_two_boxes(wide: float, narrow: float) -> None:
    offsets = np.linspace(-3, 3, 61)
    slide = (np.arange(20000) + 0.5) / 20000 - 0.5
    integral = [np.clip((offset - narrow * slide) / wide + 0.5, 0, 1).mean() for offset in offsets]
    share = trapezoid_share(offsets, np.full(61, wide), np.full(61, narrow))
    np.testing.assert_allclose(share, integral, atol=1e-6)


def test_a_linear_map_is_integrated_exactly_over_square_pixels() -> None:
    # Camera pixel c sees device columns from 0.7 c to 0.7 (c + 1) (in units from the panel's edge).
    fold, pixels = 2, 10
    fine = np.broadcast_to((np.arange(pixels * fold) + 0.5) / fold * 0.7 - 0.5, (4, pixels * fold)).copy()
    places = ScreenMap(fine, np.ones_like(fine), np.ones(fine.shape, np.float32), np.zeros(fine.shape, np.int64))
    matrix = axis_matrix(places, "x", supersampling=fold, device_px=7, across_px=5).toarray()[:pixels]
    edges = 0.7 * np.arange(pixels + 1)
    device = np.arange(8)
    overlap = np.minimum(edges[1:, None], device[None, 1:]) - np.maximum(edges[:-1, None], device[None, :-1])
    np.testing.assert_allclose(matrix, np.clip(overlap, 0, None) / 0.7, atol=1e-5)


def test_a_pixels_light_lies_where_the_integral_over_the_pixel_says_on_a_bent_map_in_uneven_light() -> None:
    # Over a pixel from -1/2 to 1/2 each way, ∫ x² = 1/12: the mean of 20 x + 8 x² - 6 y² + 5 x y in the light 1 + 0.3 x
    # is (8 - 6 + 20 · 0.3) / 12, and that of 4 y - 3 x² + 2 y² is (-3 + 2) / 12.
    fold, pixels = 2, 3
    y, x = (np.indices((fold * pixels, fold * pixels)) + 0.5) / fold - 1.5
    light, one_route = (1 + 0.3 * x).astype(np.float32), np.zeros(x.shape, np.int64)
    places = ScreenMap(20 * x + 8 * x**2 - 6 * y**2 + 5 * x * y, 4 * y - 3 * x**2 + 2 * y**2, light, one_route)
    middles = middles_of_light(places)
    middle = np.s_[fold : 2 * fold, fold : 2 * fold]
    for place, expected in ((middles.column_px, 8 / 12), (middles.row_px, -1 / 12)):
        mean = np.average(place[middle], weights=light[middle])
        assert mean == pytest.approx(expected, abs=1e-6)
    np.testing.assert_array_equal(middles.transmission, light)


def test_beside_a_change_of_route_or_a_lost_ray_no_bend_is_told() -> None:
    place = np.array([[0.0, 1, 2, 3, 14, 15, 16, np.nan, 20, 21, 23]]).repeat(3, axis=0)
    route = np.array([[0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1]]).repeat(3, axis=0)
    middles = middles_of_light(ScreenMap(place, place, np.ones(place.shape, np.float32), route))
    np.testing.assert_allclose(middles.column_px - place, [[0, 0, 0, 0, 0, 0, 0, np.nan, 0, 1 / 24, 0]] * 3, atol=1e-12)


def test_noise_is_shot_noise_and_read_noise(scene: Scene) -> None:
    camera = scene.camera.model_copy(update={"full_well_electrons": 5000.0, "read_noise_electrons": 20.0})
    for value in (0.1, 0.5, 0.8):
        level = np.full((500, 500), value, np.float32)
        photo = noisy_grey(level, camera, key=11).astype(np.float64)
        variance = (value * 5000 + 20**2) / 5000**2 * 255**2 + 1 / 12
        # Relative spread of a variance from N samples is √(2 / N); four times that.
        assert photo.var() == pytest.approx(variance, rel=4 * np.sqrt(2 / photo.size))
        assert photo.mean() == pytest.approx(value * 255, abs=4 * np.sqrt(variance / photo.size))


def test_noise_is_normal_and_the_same_for_the_same_key() -> None:
    noise = normal_noise((1000, 1001), key=5).astype(np.float64)
    count = noise.size
    assert noise.mean() == pytest.approx(0, abs=4 / np.sqrt(count))
    assert noise.var() == pytest.approx(1, abs=4 * np.sqrt(2 / count))
    assert (noise**4).mean() == pytest.approx(3, abs=4 * np.sqrt(96 / count))
    # P(|z| > 3) = 0.0026998
    assert (np.abs(noise) > 3).mean() == pytest.approx(0.0026998, abs=4 * np.sqrt(0.0027 / count))
    np.testing.assert_array_equal(noise, normal_noise((1000, 1001), key=5))
    assert np.corrcoef(noise.ravel(), normal_noise((1000, 1001), key=6).ravel())[0, 1] == pytest.approx(0, abs=0.004)


def test_a_lit_and_a_dark_display_show_signal_and_ambient(scene: Scene) -> None:
    bare = scene.model_copy(update={"fresnel": False})
    photographer = Photographer(bare)
    settings = {"stage_position_mm": 10.0, "wet": False, "object_present": False}
    lit = photographer.expected(Frame("x", np.full(96, 255, np.uint8)), **settings)
    dark = photographer.expected(Frame("x", np.zeros(96, np.uint8)), **settings)
    np.testing.assert_allclose(lit[16:48, 16:48], 255 * 0.91, rtol=1e-5)
    np.testing.assert_allclose(dark, 255 * 0.01, rtol=1e-5)


def test_the_displays_gamma_turns_half_drive_into_its_power_of_light(scene: Scene) -> None:
    panel = SceneDisplay.model_validate({**scene.display.model_dump(), "gamma": 2.2})
    photographer = Photographer(scene.model_copy(update={"display": panel, "fresnel": False}))
    lit = photographer.expected(
        Frame("y", np.full(96, 128, np.uint8)), stage_position_mm=10.0, wet=False, object_present=False
    )
    assert lit[32, 32] == pytest.approx(255 * (0.01 + 0.9 * (128 / 255) ** 2.2), rel=1e-5)


def test_the_cameras_response_bends_grey_levels(scene: Scene) -> None:
    camera = scene.camera.model_copy(update={"response_gamma": 2.2})
    photographer = Photographer(scene.model_copy(update={"camera": camera, "fresnel": False}))
    frame = Frame("x", np.full(96, 128, np.uint8))
    settings = {"stage_position_mm": 10.0, "wet": False, "object_present": False}
    value = 0.01 + 0.9 * 128 / 255
    assert photographer.expected(frame, **settings)[32, 32] == pytest.approx(255 * value ** (1 / 2.2), rel=1e-5)
    photo = simplejpeg.decode_jpeg(photographer.photograph(frame, **settings), "GRAY")[8:56, 8:56, 0]
    assert photo.mean() == pytest.approx(255 * value ** (1 / 2.2), abs=0.3)


def test_blur_widens_a_stripe_and_keeps_its_light(scene: Scene) -> None:
    camera = scene.camera.model_copy(update={"blur_px": 1.5})
    frame = Frame("x", stripe(48, 96, 2))
    settings = {"stage_position_mm": 10.0, "wet": False, "object_present": False}
    sharp = Photographer(scene).expected(frame, **settings)[32] - 2.55
    blurred = Photographer(scene.model_copy(update={"camera": camera})).expected(frame, **settings)[32] - 2.55
    column = np.arange(64)
    widths = [np.sqrt(np.average((column - column @ row / row.sum()) ** 2, weights=row)) for row in (sharp, blurred)]
    assert blurred.sum() == pytest.approx(sharp.sum(), rel=1e-3)
    # Variances add; the kernel is cut off at three to four standard deviations.
    assert widths[1] ** 2 - widths[0] ** 2 == pytest.approx(1.5**2, rel=0.05)


def test_boundaries_of_the_glass_take_their_share_of_light(scene: Scene) -> None:
    lit = Photographer(scene).expected(Frame("x", np.full(96, 255, np.uint8)), stage_position_mm=10.0, wet=False)
    # On the axis: two passages between 1 and 1.5, each keeping 0.96.
    assert lit[32, 32] == pytest.approx(255 * (0.01 + 0.9 * 0.96**2), rel=1e-3)


def test_a_photo_is_a_grey_jpeg_of_the_cameras_size(scene: Scene, photographer: Photographer) -> None:
    data = photographer.photograph(Frame("x", stripe(40, 96)), stage_position_mm=10.0, wet=True)
    height, width, colours, _ = simplejpeg.decode_jpeg_header(data)
    assert (height, width, colours) == (scene.camera.rows, scene.camera.columns, "Gray")


def test_frames_that_do_not_fit_the_panel_are_refused(photographer: Photographer) -> None:
    for frame, reason in (
        (Frame("x", np.zeros(95, np.uint8)), "95 levels along 'x' asked, the panel has 96"),
        (Frame(image=np.zeros((96, 95), np.uint8)), r"\(96, 95\) asked, the panel has \(96, 96\)"),
        (Frame(), "either levels along an axis or a whole image"),
    ):
        with pytest.raises(ValueError, match=reason):
            photographer.photograph(frame, stage_position_mm=10.0, wet=False)


def test_white_light_is_the_weighted_sum_of_its_colours() -> None:
    scene = load_scene("hemisphere_white").resized(camera_columns=48, display_columns=512)
    panel = scene.display.model_copy(update={"primary": "green"})
    frame = Frame("x", stripe(150, 512, 3), patches=(Patch(240, 190, np.full((20, 20), 255, np.uint8)),))
    settings = {"stage_position_mm": 93.0, "wet": False}
    white = Photographer(scene).expected(frame, **settings)
    total = np.zeros_like(white)
    for line in scene.spectrum():
        update = {"display": panel, "n_object": line.n_object, "n_liquid": line.n_liquid}
        total += line.weight * Photographer(scene.model_copy(update=update)).expected(frame, **settings)
    np.testing.assert_allclose(total, white, atol=1e-3)


def test_glass_spreads_the_colours_of_a_white_stripe() -> None:
    scene = load_scene("hemisphere_white").resized(camera_columns=48)
    panel = scene.display.model_copy(update={"primary": "green"})
    places = []
    for line in scene.spectrum():
        update = {"display": panel, "n_object": line.n_object, "n_liquid": line.n_liquid}
        photographer = Photographer(scene.model_copy(update=update))
        places.append(photographer.pixel_coordinates(stage_position_mm=93.0, wet=False)[24, 34, 0])
    # Near the axis a ray of height h leaves the dome turned by (n − 1) h / R; over the 65 mm from dome to display the
    # colours part by 65 · Δn · h / R. h = 10.5 px of 64 / 48 mm; Δn = 0.0083 between 620 and 465 nm (data sheet).
    height = 10.5 * 64 / 48
    apart = 65 * 0.0083 * height / 27.99 / scene.display.pitch_mm
    assert places[0] > places[1] > places[2]
    # Half as much again for the steepness of the dome out there (sin h / R = 0.5).
    assert apart < places[0] - places[2] < 3 * apart


def test_without_the_object_an_empty_room_maps_pixels_by_similar_triangles() -> None:
    scene = small_scene("thin_cone")
    seen = Photographer(scene).pixel_coordinates(stage_position_mm=20.0, wet=False, object_present=False)
    # 60 to the object's plane and 20 on: x = (c - centre) / f · 80 on a pitch of 32 / 96.
    column = (np.arange(64) - scene.camera.centre_x_px) / scene.camera.focal_x_px * 80 / (32 / 96) + 47.5
    np.testing.assert_allclose(seen[32, :, 0], column, atol=1e-5)
    row = (32 - scene.camera.centre_y_px) / scene.camera.focal_y_px * 80 / (32 / 96) + 47.5
    np.testing.assert_allclose(seen[32, :, 1], row, atol=1e-5)


def test_the_lens_model_is_that_of_opencv() -> None:
    cv2 = pytest.importorskip("cv2")
    scene = small_scene("thin_cone")
    coefficients = (0.3, -0.2, 0.01, -0.02, 0.1)
    camera = scene.camera.model_copy(update={"distortion": coefficients, "supersampling": 1, "focal_x_px": 90.0})
    scene = scene.model_copy(update={"camera": camera})
    rays = trace_sub_rays(scene, scene.world(wet=False, object_present=False))
    places = screen_map(scene, rays, 20.0)  # one ray through each pixel's centre
    rows, columns = np.nonzero(np.isfinite(places.column_px))
    seen = np.column_stack([places.column_px[rows, columns], places.row_px[rows, columns]])
    place = (seen - 47.5) * (32 / 96)
    points = np.column_stack([place, np.full(len(place), 80.0)])
    matrix = np.array([[90.0, 0, camera.centre_x_px], [0, camera.focal_y_px, camera.centre_y_px], [0, 0, 1]])
    projected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(coefficients))
    np.testing.assert_allclose(projected[:, 0], np.column_stack([columns, rows]), atol=1e-6)
