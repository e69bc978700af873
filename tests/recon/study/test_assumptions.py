"""The judge of the study of wrong assumptions, on truths and results written by hand."""

from pathlib import Path

import numpy as np

from recon.maps import Maps
from recon.status import PixelStatus
from recon.study.assumption_judge import RightUpTo, Truths, creased, errors_of, truths_of
from recon.study.wrong_assumptions import RADIUS_MM, wrong_assumptions

SHAPE = (12, 12)
JUDGED, RE_ENTERS = 0, 4


def written(folder: Path, *, status: np.ndarray, moved_px: np.ndarray) -> Path:
    """Write the truth of a flat object whose wet places at position 1 are off by ``moved_px`` along x."""
    folder.mkdir()
    point = np.zeros((*SHAPE, 3))
    point[..., 2] = 5.0
    normal = np.zeros((*SHAPE, 3))
    normal[..., 2] = 1.0
    place = np.zeros((*SHAPE, 2))
    shifted = place + np.stack([moved_px, np.zeros(SHAPE)], axis=2)
    np.savez(
        folder / "truth.npz",
        point_mm=point,
        normal=normal,
        status=status,
        place_px_pos0_liquid=place,
        place_px_pos1_liquid=shifted,
    )
    return folder


def test_what_is_wrong_reaches_pixels_that_see_another_place_and_their_neighbours(tmp_path: Path) -> None:
    status = np.full(SHAPE, JUDGED, np.uint8)
    status[0, 0] = RE_ENTERS
    moved = np.zeros(SHAPE)
    moved[6, 6] = 0.2
    moved[9, 2] = 0.01
    ideal = written(tmp_path / "ideal", status=status, moved_px=np.zeros(SHAPE))
    session = written(tmp_path / "session", status=status, moved_px=moved)
    found = truths_of(session, ideal, about_creases=False, radius_mm=RADIUS_MM)
    wanted = np.zeros(SHAPE, bool)
    wanted[5:8, 5:8] = True
    wanted[0, 0] = True
    np.testing.assert_array_equal(found.reached, wanted)
    assert found.judged.all()


def test_a_crease_is_where_normals_turn_and_the_rim_where_they_end() -> None:
    normal = np.full((3, 6, 3), np.nan)
    normal[:, 1:4], normal[:, 4] = [0.0, 0.0, 1.0], [0.6, 0.0, 0.8]
    np.testing.assert_array_equal(creased(normal)[1], [True, True, False, True, True, True])


def test_errors_are_distances_from_truth_and_from_the_dome_where_there_is_none() -> None:
    point = np.zeros((1, 3, 3))
    point[0] = [[0, 0, 10.0], [3.0, 4.0, 0.0], [0, 0, 20.5]]
    normal = np.zeros((1, 3, 3))
    normal[0] = [[0, 0, 1.0], [0, 0, 1.0], [0, 0.6, 0.8]]
    true_point, true_normal = point.copy(), np.zeros((1, 3, 3))
    true_point[0, 0], true_point[0, 2], true_normal[..., 2] = [0, 0, 10.5], np.nan, 1.0
    status = np.array([[PixelStatus.OK, PixelStatus.BAD_FIT, PixelStatus.OK]], np.uint8)
    blank = np.zeros((1, 3), np.float32)
    maps = Maps(point, normal, blank + np.float32(0.25), blank, blank, status)
    everywhere = np.ones((1, 3), bool)
    found = errors_of(maps, Truths(true_point, true_normal, everywhere, everywhere, radius_mm=20.0), covered=False)
    np.testing.assert_allclose(found.point_mm, [[0.5, np.nan, 0.5]])
    assert found.right(RightUpTo(mm=0.6, deg=40.0)).tolist() == [[True, False, True]]
    assert not found.right(RightUpTo(mm=0.4, deg=40.0)).any()
    # A point at the right place whose normal is off by 36.9° is not right.
    assert found.right(RightUpTo(mm=0.6, deg=30.0)).tolist() == [[True, False, False]]
    # By hand: cos = 0.8 between (0, 0.6, 0.8) and the radial direction.
    np.testing.assert_allclose(found.normal_deg, [[0.0, np.nan, np.degrees(np.arccos(0.8))]], atol=1e-6)
    np.testing.assert_allclose(found.sd_mm, [[0.25, np.nan, 0.25]])


def test_every_wrong_assumption_is_in_its_scene_and_not_in_the_one_beside_it() -> None:
    for wrong in wrong_assumptions():
        assert ("when_filled" in wrong.scene()) == bool(wrong.when_filled)
        assert "when_filled" not in wrong.scene(disturbed=False)
