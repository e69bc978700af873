"""A display that slipped when the tank was filled, seen through the simulator's optics; what is wrong is known exactly."""

import numpy as np
import pytest
from traced_session import Mishap, TracedSession, traced_session, with_noise

from recon.method import Limits
from recon.reconstruct import Crossing, cross_paths
from recon.registration.gap_fit import Motions
from recon.registration.registration_stage import record_of, registration_of, with_carried
from recon.registration.session_slips import Registration, registered
from recon.sessions.manifest import Manifest
from recon.status import PixelStatus
from sim_backend.scene import Scene, load_scene
from sim_backend.scene_parts import SceneGlass

NOISE_PX = 0.1
SLIPS = {"pos0_liquid": (0.2, -0.3, 0.002), "pos1_liquid": (-0.5, 0.3, -0.001)}
SLIPPED = np.array([*SLIPS["pos0_liquid"], *SLIPS["pos1_liquid"]])


def hemisphere(pixels: int = 80) -> Scene:
    """The paper's hemisphere over a tablet behind 1.5 mm of glass."""
    scene = load_scene("hemisphere").resized(camera_columns=pixels)
    glass = SceneGlass(thickness_mm=1.5, n=1.52)
    return scene.model_copy(update={"display": scene.display.model_copy(update={"cover_glass": glass})})


def measured(session: TracedSession, *, known: np.ndarray | None = None) -> Registration:
    found = registration_of(session.sweeps, session.manifest, known=known)
    assert found is not None
    return found


def crossing_of(session: TracedSession, manifest: Manifest) -> Crossing:
    return cross_paths(session.sweeps, manifest, method="full", limits=Limits())[1]


@pytest.fixture(scope="module")
def slipped() -> TracedSession:
    return traced_session(hemisphere(), noise_px=NOISE_PX, mishap=Mishap(SLIPS))


def test_slips_of_both_displays_are_found_to_within_their_own_uncertainty(slipped: TracedSession) -> None:
    registration = measured(slipped)
    error = registration.motions - SLIPPED
    # χ² of six numbers is above 22.5 once in a thousand.
    assert error @ np.linalg.solve(registration.covariance, error) < 22.5
    assert np.sqrt(np.diag(registration.covariance)).max() < 0.05
    assert record_of(registration).gap_before > 5
    assert registration.fit.gap_after == pytest.approx(1, abs=0.08)  # a robust rms of 3,000 draws is known to 1.4 %


def test_without_noise_the_slips_are_found_exactly() -> None:
    session = traced_session(hemisphere(), noise_px=0.0, stated_sd_px=0.01, mishap=Mishap(SLIPS))
    # The search ends a hundredth of an sd from the end; a hundredth of 0.01 px of 0.38 mm is far below this.
    np.testing.assert_allclose(measured(session).motions, SLIPPED, atol=2e-5)


def test_a_display_that_stayed_where_it_was_is_left_there() -> None:
    registration = measured(traced_session(hemisphere(), noise_px=NOISE_PX))
    assert not registration.applied
    assert not registration.motions.any()
    assert registration.sentences("mm") == ()


def test_normalised_errors_of_the_slips_have_unit_variance_over_many_noises() -> None:
    exact = traced_session(hemisphere(48), noise_px=0.0, mishap=Mishap(SLIPS))
    square = []
    for seed in range(12):
        registration = measured(with_noise(exact, noise_px=NOISE_PX, seed=seed))
        error = registration.motions - SLIPPED
        square.append(error @ np.linalg.solve(registration.covariance, error) / 6)
    # 72 squares of standard normal numbers: their mean is known to √(2/72) = 0.17; four of those.
    assert np.mean(square) == pytest.approx(1, abs=0.67)


def test_a_calibration_that_knows_better_keeps_the_poses(slipped: TracedSession) -> None:
    certain = np.diag(np.square([1e-5, 1e-5, 1e-7] * 2))
    registration = measured(slipped, known=certain)
    assert registration.fit.directions.shape[1] == 0
    assert not registration.applied


def test_a_slip_that_contradicts_the_calibration_is_corrected_and_said(slipped: TracedSession) -> None:
    registration = measured(slipped, known=np.diag(np.square([0.02, 0.02, 0.0002] * 2)))
    assert registration.applied
    assert "contradicts the calibration" in " ".join(registration.sentences("mm"))


def test_a_direction_that_gaps_do_not_tell_is_not_moved() -> None:
    # A row of pixels through the middle: every path runs in the plane y = 0, and what slips along x opens no gap there.
    scene = hemisphere(1601)
    camera = scene.camera.model_copy(update={"rows": 1, "centre_y_px": 0.0})
    mishap = Mishap({"pos1_liquid": (0.3, 0.3, 0.0)})
    session = traced_session(scene.model_copy(update={"camera": camera}), noise_px=0.01, mishap=mishap)
    registration = measured(session)
    assert registration.applied
    # A hundredth of the slip, since which direction is the silent one is known from noisy paths only.
    assert np.abs(registration.motions[[0, 3]]).max() < 0.003
    across_sd = np.sqrt(registration.covariance[4, 4])
    assert registration.motions[4] == pytest.approx(0.3, abs=4 * across_sd)
    assert across_sd < 0.05


def test_carried_variance_is_that_of_points_and_normals_when_the_poses_vary(slipped: TracedSession) -> None:
    registration = measured(slipped)
    manifest = registered(slipped.manifest, registration.motions)
    crossing = with_carried(crossing_of(slipped, manifest), registration, manifest)
    fine = crossing.status == PixelStatus.OK
    variance_mm2, variance_rad2 = np.zeros(fine.sum()), np.zeros(fine.sum())
    root = np.linalg.cholesky(registration.covariance)
    for column in root.T:
        ahead, behind = (_crossed(slipped, registration.motions + sign * 0.1 * column, fine) for sign in (1, -1))
        variance_mm2 += (((ahead[0] - behind[0]) / 0.2) ** 2).sum(1)
        variance_rad2 += (((ahead[1] - behind[1]) / 0.2) ** 2).sum(1)
    # Terms of the order of gap times shift are left out.
    np.testing.assert_allclose(np.sqrt(crossing.carried_mm2[fine]), np.sqrt(variance_mm2), rtol=0.1, atol=1e-4)
    np.testing.assert_allclose(np.sqrt(crossing.carried_rad2[fine]), np.sqrt(variance_rad2), rtol=0.02, atol=1e-6)


def _crossed(session: TracedSession, motions: Motions, fine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    crossing = crossing_of(session, registered(session.manifest, motions))
    return crossing.points.point_mm[fine], crossing.normal[fine]
