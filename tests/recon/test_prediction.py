"""Predicted uncertainties beside the errors of sessions traced through the simulator's optics, which know no prediction."""

import numpy as np
import pytest
from traced_session import traced_session, with_noise

from recon.geometry.prediction import Guess, Indices, dome, facet, predicted
from recon.method import Limits
from recon.reconstruct import cross_paths
from recon.sessions.manifest import DisplayPanel, Pose
from sim_backend.scene import load_scene

NOISE_PX = 0.05
ROUNDS = 12
AWAY = np.array([0.0, 0.0, 1.0])
PANEL = DisplayPanel(columns=1000, rows=1000, pitch_mm=0.1)


def poses(near_mm: float, apart_mm: float) -> tuple[Pose, Pose]:
    return tuple(  # type: ignore[return-value]  # two of them
        Pose(centre_mm=(0.0, 0.0, z), x_axis=(1.0, 0.0, 0.0), y_axis=(0.0, 1.0, 0.0))
        for z in (near_mm, near_mm + apart_mm)
    )


def test_prediction_and_stated_uncertainties_are_those_that_errors_have() -> None:
    scene = load_scene("hemisphere").resized(camera_columns=48)
    exact = traced_session(scene, noise_px=0.0)
    manifest = exact.manifest
    square_mm, square_rad, whitened, tilts = [], [], [], []
    for seed in range(ROUNDS):
        session = with_noise(exact, noise_px=NOISE_PX, seed=seed)
        # Without limits on gap or angle nothing is selected by its noise.
        limits = Limits(gap_sigma=1e9, angle_sigma=0.0)
        crossing = cross_paths(session.sweeps, manifest, method="full", limits=limits)[1]
        judged = exact.truth.judged.ravel()[crossing.pixels]
        error = crossing.points.point_mm[judged] - exact.truth.point_mm.reshape(-1, 3)[crossing.pixels[judged]]
        tilt = crossing.normal[judged] - exact.truth.normal.reshape(-1, 3)[crossing.pixels[judged]]
        sure = crossing.points.angle_rad[judged] > 20 * crossing.points.angle_sd_rad[judged]
        covariance = crossing.points.covariance[judged][sure]
        whitened.append((error[sure] * np.linalg.solve(covariance, error[sure][..., None])[..., 0]).sum(axis=1))
        tilts.append((tilt**2).sum(axis=1) / crossing.normal_sd_rad[judged] ** 2)
        square_mm.append((error**2).sum(axis=1))
        square_rad.append((tilt**2).sum(axis=1))
    # About 9,000 errors of three numbers, and 12,000 of two: their mean squares are known to 1 %. Four of those, and the
    # curvature of a crossing at a twentieth of its angle (1/400).
    assert np.mean(np.concatenate(whitened)) / 3 == pytest.approx(1, abs=0.045)
    assert np.mean(np.concatenate(tilts)) == pytest.approx(1, abs=0.04)

    truth = exact.truth
    guess = Guess(truth.point_mm[truth.judged], truth.normal[truth.judged], scene.n_object)
    assert manifest.camera.pose is not None
    found = predicted(
        guess,
        manifest.display_poses,
        manifest.display,
        camera_mm=np.array(manifest.camera.pose.centre_mm),
        towards_display=AWAY,
        indices=Indices(manifest.n_liquid(), manifest.n_air),
        place_sd_px=NOISE_PX,
    )
    assert found.off_panel_share == 0
    # The prediction leaves out the few nearly parallel paths. A pixel's rms over 12 rounds is known to a tenth or a fifth; the
    # median over a thousand pixels is biased low by about 1 / (3 · 12) of it.
    assert found.point_sd_mm == pytest.approx(np.median(np.sqrt(np.mean(square_mm, axis=0))), rel=0.06)
    assert found.normal_sd_rad == pytest.approx(np.median(np.sqrt(np.mean(square_rad, axis=0))), rel=0.06)


def test_normals_are_twice_as_sure_with_the_displays_twice_as_far_apart() -> None:
    guess = dome(apex_mm=np.zeros(3), towards_display=AWAY, radius_mm=10.0, n=1.5)
    near, far = (
        predicted(
            guess,
            poses(10.0, apart),
            PANEL,
            camera_mm=None,
            towards_display=AWAY,
            indices=Indices(1.333, 1.0),
            place_sd_px=0.1,
        )
        for apart in (10.0, 20.0)
    )
    # Exact for every point; the nearer pair loses a few more nearly parallel paths, and the median is over the others.
    assert near.normal_sd_rad / far.normal_sd_rad == pytest.approx(2.0, rel=0.01)
    assert far.share - 0.05 < near.share <= far.share


def test_a_tilted_plane_is_seen_under_the_angle_that_snells_law_gives() -> None:
    tilt = np.radians(20.0)
    guess = facet(middle_mm=np.zeros(3), towards_display=AWAY, size_mm=5.0, tilt_rad=tilt, n=1.5)
    found = predicted(
        guess,
        poses(10.0, 10.0),
        PANEL,
        camera_mm=None,
        towards_display=AWAY,
        indices=Indices(1.333, 1.0),
        place_sd_px=0.1,
    )
    expected = np.arcsin(1.5 * np.sin(tilt)) - np.arcsin(1.5 / 1.333 * np.sin(tilt))
    assert found.angle_rad == pytest.approx(expected, rel=1e-9)
    assert found.share == 1.0


def test_light_that_misses_the_panel_is_counted() -> None:
    small = DisplayPanel(columns=20, rows=20, pitch_mm=0.1)
    guess = dome(apex_mm=np.zeros(3), towards_display=AWAY, radius_mm=10.0, n=1.5)
    found = predicted(
        guess,
        poses(10.0, 10.0),
        small,
        camera_mm=None,
        towards_display=AWAY,
        indices=Indices(1.333, 1.0),
        place_sd_px=0.1,
    )
    assert found.off_panel_share > 0.4
