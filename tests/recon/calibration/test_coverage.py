"""Advice on missing views in plain words; and a stage that turns the display is called crooked, a straight one is not."""

import numpy as np
import pytest
from seen_corners import lab_scene, panel_view, rotation, slipped_scene, true_lens

from recon.calibration.board import board_for_display
from recon.calibration.coverage import advice, coverage
from recon.calibration.detection import BoardView
from recon.calibration.display_poses import Travel, display_poses, straightness
from recon.calibration.errors import CalibrationError
from recon.calibration.intrinsics import calibrate_lens, without_views
from recon.calibration.sight_line import PanelPose
from recon.sessions.manifest import DisplayPanel

COLUMNS, ROWS = 800, 600
PANEL = DisplayPanel(columns=2048, rows=1536, pitch_mm=0.0962)


def view_at(left: float, top: float) -> BoardView:
    """Return corners in a patch of 250 by 190 px of the photo."""
    x, y = np.meshgrid(left + np.linspace(0, 250, 6), top + np.linspace(0, 190, 5))
    place = np.column_stack([x.ravel(), y.ravel()])
    return BoardView(np.arange(30), place, place - place.mean(axis=0), "either", f"{left:g},{top:g}")


def pose(*degrees: float, distance_mm: float = 400.0) -> PanelPose:
    return PanelPose(rotation(*degrees, 0.0), np.array([0.0, 0.0, distance_mm]))


def everywhere() -> list[BoardView]:
    return [view_at(left, top) for left in (10, 270, 540) for top in (5, 200, 400)] + [view_at(270, 200)]


TILTS = [(30, 0), (-30, 0), (0, 30), (0, -30), *[(0, 0)] * 6]


def test_views_all_over_tilted_and_at_two_distances_need_no_advice() -> None:
    poses = [pose(a, b, distance_mm=d) for (a, b), d in zip(TILTS, [300, 500] * 5, strict=True)]
    assert advice(coverage(everywhere(), poses, columns=COLUMNS, rows=ROWS)) == ()


def test_each_kind_of_missing_view_has_its_sentence() -> None:
    views, poses = [view_at(540, 400)] * 4, [pose(30, 0), pose(0, 0), pose(0, 0), pose(0, 0)]
    said = " ".join(advice(coverage(views, poses, columns=COLUMNS, rows=ROWS)))
    for words in (
        "top left",
        "bottom left",
        "top edge away",
        "right edge away",
        "left edge away",
        "same distance",
        "at least 6 more",
    ):
        assert words in said
    assert "bottom right" not in said
    assert "bottom edge away" not in said  # the one tilt that there is: it takes the bottom edge away


@pytest.mark.parametrize("tilt", [(30, 0), (-30, 0), (0, 30), (0, -30)])
def test_the_missing_tilt_is_named_as_the_person_who_holds_the_board_sees_it(tilt: tuple[int, int]) -> None:
    poses = [pose(*(0, 0) if one == tilt else one, distance_mm=d) for one, d in zip(TILTS, [300, 500] * 5, strict=True)]
    (said,) = advice(coverage(everywhere(), poses, columns=COLUMNS, rows=ROWS))
    # Independent of the sentence: the edge that this tilt takes farther away from the camera.
    edges = {"right edge": [1.0, 0, 0], "left edge": [-1.0, 0, 0], "top edge": [0, -1.0, 0], "bottom edge": [0, 1.0, 0]}
    away = max(edges, key=lambda edge: float((rotation(*tilt, 0.0) @ np.array(edges[edge]))[2]))
    assert away in said


def test_too_few_views_are_told_in_a_sentence() -> None:
    with pytest.raises(CalibrationError, match="1 of 1 photos show at least 8 corners of the board, 3 are needed"):
        calibrate_lens([view_at(0, 0)], columns=COLUMNS, rows=ROWS)


def test_a_view_that_does_not_exist_cannot_be_left_out() -> None:
    with pytest.raises(CalibrationError, match="no view is called nowhere"):
        without_views([view_at(0, 0)], ["nowhere"])


@pytest.mark.parametrize(("turn_deg", "straight"), [(0.0, True), (0.5, False)])
def test_a_stage_that_turns_the_display_is_called_crooked(turn_deg: float, straight: bool) -> None:
    scene = lab_scene()
    stage_mm = scene.stage_positions_mm
    second = slipped_scene(scene, stage_mm[1], np.array([np.radians(turn_deg), 0, 0, 0, 0, 0]))
    corner_mm = board_for_display(PANEL, squares_along=9).board.corner_mm()
    rng = np.random.default_rng(4)
    views = {p: [panel_view((scene, second)[p], corner_mm, stage_mm[p], rng=rng, sd_px=0.05)] for p in (0, 1)}
    covariance = np.diag(np.array([0.5, 0.5, 0.6, 0.6, 4e-4, 3e-3, 3e-5, 3e-5, 7e-3]) ** 2)
    found = straightness(
        display_poses(views, lens=true_lens(scene), lens_covariance=covariance, travel=Travel(40.0, 0.02))
    )
    assert found.sentence().startswith("straight:" if straight else "not straight:")
    assert abs(found.turn_rad - np.radians(turn_deg)) < 4 * found.turn_sd_rad
