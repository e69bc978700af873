"""What a session shows of the method's assumptions: traced through the simulator's optics, with one of them wrong at a time."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from traced_session import Mishap, TracedSession, traced_session

from recon.checks.shared_gaps import shared_gaps, with_gaps_of_area, with_shared_gaps
from recon.checks.wet_spots import GROWN_PX, WetSpot, spot_pixels, wet_spots
from recon.method import Limits
from recon.reconstruct import Crossing, cross_paths
from recon.registration.registration_stage import registration_of
from recon.running.outcome import Outcome, reconstruct
from recon.running.settings import Settings
from recon.sessions.session import Session
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.noise import NoiseModel
from sim_backend.scene import Scene, load_scene
from sim_backend.specimens import SlottedHemisphere


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("hemisphere").resized(camera_columns=96, display_columns=2048)


def outcome_of(session: TracedSession) -> Outcome:
    return reconstruct(Session(Path("no photos"), session.manifest, {}), session.sweeps, Settings())


def test_nothing_is_doubted_where_nothing_is_wrong(scene: Scene) -> None:
    assert outcome_of(traced_session(scene, noise_px=0.1)).doubts == ()


def test_an_object_that_moved_aside_makes_points_and_normals_lean_against_each_other(scene: Scene) -> None:
    session = traced_session(scene, noise_px=0.1, mishap=Mishap(object_shift_mm=(0.0, 0.3, 0.0)))
    (told,) = outcome_of(session).doubts
    assert "Points and normals lean against each other" in told


def test_light_that_enters_again_is_no_slip_of_the_display_and_widens_the_standard_deviations(scene: Scene) -> None:
    part = SlottedHemisphere(radius_mm=27.99, slot_mm=2.0, slot_depth_mm=8.0, slot_tilt_deg=10.0)
    session = traced_session(scene.model_copy(update={"specimen": part}), noise_px=0.1)
    registration = registration_of(session.sweeps, session.manifest)
    assert registration is not None
    assert not registration.applied
    _, crossing = cross_paths(session.sweeps, session.manifest, method="full", limits=Limits())
    shape = (scene.camera.rows, scene.camera.columns)
    gaps = shared_gaps(crossing, shape=shape)
    found = with_shared_gaps(crossing, gaps, n_liquid=1.3355, n_air=1.0)
    shared, area = gaps.stands_out, gaps.area()
    np.testing.assert_array_equal(found.carried_mm2 > 0, (shared | area).ravel()[crossing.pixels])
    # The slot is on the side x > 0: the photo's right half, and it ends at the axis.
    assert not shared[:, : shape[1] // 2 - 3].any()
    assert shared[:, shape[1] // 2 + 3 :].sum() > 300
    # The other half is not pulled: its points stand off the dome by no more than they say.
    maps = outcome_of(session).maps
    other = maps.valid() & ~area & (np.arange(shape[1]) < shape[1] // 2 - 3)
    off = np.abs(np.linalg.norm(maps.point_mm[other], axis=1) - 27.99) / maps.sd_mm[other]
    assert np.mean(off > 3) < 0.01


def crossings_with_gaps(scene: Scene, normalised: np.ndarray) -> tuple[TracedSession, np.ndarray, Crossing]:
    """Return a session's crossings with these gaps, in standard deviations, [pixels of the object] in place of its own."""
    session = traced_session(scene, noise_px=0.1)
    status, crossing = cross_paths(session.sweeps, session.manifest, method="full", limits=Limits())
    where = np.flatnonzero(np.isin(crossing.status, (PixelStatus.OK, PixelStatus.GAP_TOO_LARGE)))
    gap_mm = crossing.points.gap_mm.copy()
    gap_mm[where] = (normalised.ravel()[crossing.pixels] * crossing.points.gap_sd_mm)[where]
    ours = crossing.status.copy()
    ours[where] = np.where(
        np.abs(normalised.ravel()[crossing.pixels[where]]) < 5, PixelStatus.OK, PixelStatus.GAP_TOO_LARGE
    )
    status = status.copy()
    status[crossing.pixels] = ours
    return session, status, replace(crossing, points=replace(crossing.points, gap_mm=gap_mm), status=ours)


def test_a_gap_that_its_area_shares_is_not_odd_and_one_that_differs_from_it_is(scene: Scene) -> None:
    shape = (scene.camera.rows, scene.camera.columns)
    normalised = np.zeros(shape)
    # Gaps of 4 sd all over one half, just above the limit of 5 at some pixels there, and far above it at one.
    normalised[:, 48:] = 4.0
    alike, odd, elsewhere = ([44, 50, 52], [60, 60, 56]), ([40], [60]), ([48], [30])
    normalised[alike], normalised[odd], normalised[elsewhere] = 5.4, 12.0, 5.4
    session, status, crossing = crossings_with_gaps(scene, normalised)
    shared = shared_gaps(crossing, shape=shape)
    found, after = with_gaps_of_area(status, crossing, shared, session.manifest, sigma=5.0)
    found = found.reshape(shape)
    assert (status.reshape(shape)[alike] == PixelStatus.GAP_TOO_LARGE).all()
    assert (found[alike] == PixelStatus.OK).all()
    assert found[odd] == found[elsewhere] == PixelStatus.GAP_TOO_LARGE
    np.testing.assert_array_equal(found.ravel()[after.pixels], after.status)
    # Its own gap widens it, not the mean of those about it alone: that over the sine of the angle between the paths.
    wider = with_shared_gaps(after, shared, n_liquid=1.3355, n_air=1.0)
    pixel = np.searchsorted(after.pixels, 44 * shape[1] + 60)
    own_mm = 5.4 * after.points.gap_sd_mm[pixel] / np.sin(after.points.angle_rad[pixel])
    np.testing.assert_allclose(np.sqrt(wider.carried_mm2[pixel]), own_mm)


def test_a_gap_that_its_area_shares_gives_no_point_behind_the_camera_or_the_display(scene: Scene) -> None:
    shape = (scene.camera.rows, scene.camera.columns)
    normalised = np.full(shape, 4.0)
    normalised[44, 60] = 5.4
    session, status, crossing = crossings_with_gaps(scene, normalised)
    pixel = np.searchsorted(crossing.pixels, 44 * shape[1] + 60)
    behind = crossing.points.distance_liquid_mm.copy()
    behind[pixel] = -1.0
    crossing = replace(crossing, points=replace(crossing.points, distance_liquid_mm=behind))
    _, after = with_gaps_of_area(status, crossing, shared_gaps(crossing, shape=shape), session.manifest, sigma=5.0)
    assert after.status[pixel] == PixelStatus.GAP_TOO_LARGE


def test_a_spot_with_the_gaps_of_an_area_gets_no_point(scene: Scene) -> None:
    shape = (scene.camera.rows, scene.camera.columns)
    normalised = np.full(shape, 4.0)
    spot = np.zeros(shape, dtype=bool)
    spot[42:48, 56:62] = True
    normalised[spot] = 5.4
    session, status, crossing = crossings_with_gaps(scene, normalised)
    given = partial(
        with_gaps_of_area, status, crossing, shared_gaps(crossing, shape=shape), session.manifest, sigma=5.0
    )
    with_points, without = given()[0], given(spots=spot)[0]
    assert (with_points.reshape(shape)[spot] == PixelStatus.OK).any()
    assert (without.reshape(shape)[spot] == PixelStatus.GAP_TOO_LARGE).all()


SHAPE = (40, 40)
AXES = ("x", "y")


def sweeps_with(bad: dict[str, np.ndarray]) -> dict[tuple[str, str], SweepResult]:
    """Return sweeps that are sound but where ``bad`` says, by the name of a set, that a curve is not that of one stripe."""
    blank = np.zeros(SHAPE)
    whole = SweepResult(blank, blank.astype(np.float32), blank.astype(np.uint8), NoiseModel(1.0), np.nan, (), ())
    names = [f"pos{position}_{condition}" for condition in ("air", "liquid") for position in (0, 1)]
    found = {}
    for name in names:
        status = np.where(bad.get(name, np.zeros(SHAPE, bool)), np.uint8(PixelStatus.BAD_FIT), np.uint8(PixelStatus.OK))
        found |= {(name, axis): replace(whole, status=status) for axis in AXES}
    return found


def test_a_patch_that_is_bad_in_liquid_alone_is_a_spot_and_a_line_or_one_bad_in_air_is_not() -> None:
    patch, line, both = (np.zeros(SHAPE, bool) for _ in range(3))
    patch[10:14, 20:25] = True
    # Along an edge of the object or a row of the display's pixels: wide enough for a patch, and far too long for a bubble.
    line[34:38, 2:38] = True
    line[30, 3:35] = True
    both[20:24, 5:9] = True
    sweeps = sweeps_with({"pos1_liquid": patch | line | both, "pos0_air": both})
    status = np.where(patch | line | both, np.uint8(PixelStatus.BAD_FIT), np.uint8(PixelStatus.OK))
    nowhere = np.zeros(SHAPE, bool)
    assert wet_spots(sweeps, status, nowhere) == (WetSpot(row=11, col=22, pixels=20),)


def test_a_ring_round_gaps_that_neighbours_share_is_one_spot_with_its_inside() -> None:
    row, col = np.indices(SHAPE)
    distance = np.hypot(row - 20, col - 12)
    ring, inside = (distance > 3.5) & (distance < 5), distance < 2
    status = np.where(ring, np.uint8(PixelStatus.BAD_FIT), np.uint8(PixelStatus.OK))
    (spot,) = wet_spots(sweeps_with({"pos0_liquid": ring}), status, inside)
    assert (spot.row, spot.col) == (20, 12)
    assert spot.pixels == np.count_nonzero(distance < 5)


def test_a_spot_of_scattered_odd_pixels_is_left_out_whole_and_with_those_beside_it() -> None:
    row, col = np.indices(SHAPE)
    within = (np.abs(row - 20) <= 3) & (np.abs(col - 12) <= 3)
    # Every third pixel of a bubble shows that something is wrong.
    odd = within & ((row + col) % 3 == 0)
    lone = np.zeros(SHAPE, bool)
    lone[5, 30] = True
    status = np.where(odd | lone, np.uint8(PixelStatus.GAP_TOO_LARGE), np.uint8(PixelStatus.OK))
    spot = spot_pixels(sweeps_with({}), status)
    reach = 3 + GROWN_PX
    assert spot[within].all()
    assert not spot[(np.abs(row - 20) > reach) | (np.abs(col - 12) > reach)].any()


def test_nothing_within_a_block_of_an_edge_that_air_shows_too_is_a_spot() -> None:
    odd = np.zeros(SHAPE, bool)
    odd[4:8, 20:24] = True
    odd[20:24, 20:24] = True
    crease = np.zeros(SHAPE, bool)
    crease[2, :] = True
    status = np.where(odd | crease, np.uint8(PixelStatus.BAD_FIT), np.uint8(PixelStatus.OK))
    both = wet_spots(sweeps_with({"pos0_liquid": odd}), status, np.zeros(SHAPE, bool))
    assert [(spot.row, spot.col) for spot in both] == [(5, 21), (21, 21)]
    inner = wet_spots(sweeps_with({"pos0_liquid": odd, "pos1_air": crease}), status, np.zeros(SHAPE, bool))
    assert [(spot.row, spot.col) for spot in inner] == [(21, 21)]
    # A crease that leaves every curve sound: the place on the display goes on elsewhere.
    jump = sweeps_with({"pos0_liquid": odd})
    place = np.indices(SHAPE)[0] * 0.6 + np.where(np.indices(SHAPE)[0] > 2, 18.0, 0.0)
    jump[("pos1_air", "y")] = replace(jump[("pos1_air", "y")], place_px=place)
    assert wet_spots(jump, status, np.zeros(SHAPE, bool)) == inner
