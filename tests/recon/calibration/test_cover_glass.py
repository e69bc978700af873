"""Cover glass over the display's pixels: what ignoring it costs, that the model is exact, what photos tell of its thickness."""

import numpy as np
import pytest
from seen_corners import lab_scene, panel_view, seen_places, slipped_scene, true_lens, true_pose
from seen_object import PANEL, errors, pixels_of

from recon.calibration.board import board_for_display
from recon.calibration.constraints import glass_known, lens_known, slip, travel_known
from recon.calibration.detection import BoardView
from recon.calibration.display_poses import AIR_PANELS, GlassKnowledge, Travel, display_poses
from recon.calibration.errors import CalibrationError
from recon.calibration.fep_error import Geometry
from recon.calibration.wet_pose import WET_PANELS, wet_poses
from recon.sessions.manifest import CoverGlass

GLASS = CoverGlass(thickness_mm=1.5, n=1.52)
CORNER_SD_PX = 0.05
# Tilts of the display in front of the camera, for views that see the glass obliquely.
OBLIQUE_RAD = np.radians(40.0)


def test_recon_models_the_glass_exactly_in_air_and_in_liquid_and_ignoring_it_costs_half_a_millimetre() -> None:
    scene = lab_scene(glass_mm=GLASS.thickness_mm)
    panels = {name: true_pose(scene, place) for name, place in zip(AIR_PANELS, scene.stage_positions_mm, strict=True)}
    geometry, point_mm, normal = pixels_of(scene, scene, rng=np.random.default_rng(0), sd_px=0.0)
    modelled = errors(Geometry(geometry.screen_mm, geometry.n_liquid, cover_glass=GLASS), panels, point_mm, normal)
    ignored = errors(geometry, panels, point_mm, normal)
    # Display places of the simulator are kept as float64; paths cross at 3° and more, which multiplies rounding by 20.
    assert modelled.point_mm < 1e-6
    assert modelled.normal_deg < 1e-4
    # The panel seems t/n below the glass in air and t·n_liquid/n in liquid: 0.33 mm apart, more where paths cross flat.
    assert ignored.point_mm > GLASS.thickness_mm * (geometry.n_liquid - 1) / GLASS.n


@pytest.mark.slow
def test_oblique_views_tell_the_thickness_of_the_glass() -> None:
    scene = lab_scene(glass_mm=GLASS.thickness_mm)
    stage_mm = scene.stage_positions_mm
    corner_mm = board_for_display(PANEL, squares_along=12).board.corner_mm()
    rng = np.random.default_rng(5)
    straight = {p: [panel_view(scene, corner_mm, stage_mm[p], rng=rng, sd_px=CORNER_SD_PX)] for p in (0, 1)}
    oblique: list[BoardView] = []
    for turn in np.radians([0.0, 60.0, 120.0, 180.0, 240.0, 300.0]):
        lean = OBLIQUE_RAD * np.array([np.cos(turn), np.sin(turn)])
        turned = slipped_scene(scene, stage_mm[0], np.array([*lean, 0, 0, 0, 30.0]))
        place_px = seen_places(turned, corner_mm, stage_mm[0])
        oblique.append(panel_view(turned, corner_mm, stage_mm[0], rng=rng, sd_px=CORNER_SD_PX, exact=place_px))
    lens_covariance = np.diag(np.array([0.5, 0.5, 0.6, 0.6, 4e-4, 3e-3, 3e-5, 3e-5, 7e-3]) ** 2)
    guessed = CoverGlass(thickness_mm=1.0, n=GLASS.n)
    lens = rng.multivariate_normal(true_lens(scene), lens_covariance)
    found = display_poses(
        straight,
        lens=lens,
        lens_covariance=lens_covariance,
        travel=Travel(40.0, 0.02),
        cover_glass=guessed,
        glass=GlassKnowledge(sd_mm=1.0),
        other_views=oblique,
    )
    sd_mm = float(np.sqrt(found.covariance_of("glass")[0, 0]))
    assert sd_mm < 0.5  # known beforehand to 1 mm: the photos tell more than that
    assert abs(found.state.glass_mm - GLASS.thickness_mm) < 4 * sd_mm

    # Under liquid the glass bends light less: photos through it tell the thickness once more, with the poses there.
    assert scene.n_liquid is not None
    wet = {p: [panel_view(scene, corner_mm, stage_mm[p], rng=rng, sd_px=CORNER_SD_PX, wet=True)] for p in (0, 1)}
    known = [
        lens_known(lens, lens_covariance),
        travel_known(*AIR_PANELS, travel_mm=40.0, sd_mm=0.02),
        glass_known(guessed.thickness_mm, sd_mm=1.0),
    ]
    both = wet_poses(
        found, straight, wet, n_liquid=scene.n_liquid, cover_glass=guessed, known=known, other_views=oblique
    )
    both_sd_mm = float(np.sqrt(both.covariance_of("glass")[0, 0]))
    assert both_sd_mm < sd_mm
    assert abs(both.state.glass_mm - GLASS.thickness_mm) < 4 * both_sd_mm
    for name, place in zip(WET_PANELS, stage_mm, strict=True):
        pose = true_pose(scene, place)
        off = slip(pose, both.state.panels[name])
        error = np.concatenate([pose.rotation @ off[:3], pose.rotation @ off[3:]])
        assert (np.abs(error) < 4.5 * np.sqrt(np.diag(both.covariance_of(name)))).all(), name


def test_a_thickness_is_not_estimated_without_the_glasss_index() -> None:
    scene = lab_scene()
    corner_mm = board_for_display(PANEL, squares_along=9).board.corner_mm()
    rng = np.random.default_rng(1)
    views = {p: [panel_view(scene, corner_mm, scene.stage_positions_mm[p], rng=rng, sd_px=0.1)] for p in (0, 1)}
    with pytest.raises(CalibrationError, match="give its index and about how thick it is"):
        display_poses(
            views,
            lens=true_lens(scene),
            lens_covariance=np.eye(9),
            travel=None,
            glass=GlassKnowledge(sd_mm=1.0),
        )
