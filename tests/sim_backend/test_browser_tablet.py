"""A picture of a screen told in the words of a frame: exactly, and in the fewest."""

import numpy as np
import pytest

from drivers.protocols import Frame
from sim_backend.browser_tablet import frame_of_picture

SHAPE = (20, 30)


def drawn(frame: Frame) -> np.ndarray:
    if frame.image is not None:
        return frame.image
    assert frame.levels is not None
    levels = frame.levels if frame.axis == "x" else frame.levels[:, None]
    picture = np.broadcast_to(levels, SHAPE).copy()
    for patch in frame.patches:
        rows, columns = patch.levels.shape
        picture[patch.row : patch.row + rows, patch.column : patch.column + columns] = patch.levels
    return picture


def striped(axis: str) -> np.ndarray:
    along = np.arange(SHAPE[1] if axis == "x" else SHAPE[0], dtype=np.uint8) * 8
    return np.broadcast_to(along if axis == "x" else along[:, None], SHAPE).copy()


@pytest.mark.parametrize("axis", ["x", "y"])
def test_levels_along_an_axis_are_told_as_such(axis: str) -> None:
    frame = frame_of_picture(striped(axis))
    assert frame.axis == axis
    assert frame.patches == ()
    np.testing.assert_array_equal(drawn(frame), striped(axis))


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_tag_on_a_stripe_is_told_as_a_patch(axis: str) -> None:
    picture = striped(axis)
    picture[3:9, 4:10] = 255 - picture[3:9, 4:10]
    frame = frame_of_picture(picture)
    assert frame.axis == axis
    assert [(patch.column, patch.row, patch.levels.shape) for patch in frame.patches] == [(4, 3, (6, 6))]
    np.testing.assert_array_equal(drawn(frame), picture)


def test_a_screen_of_one_level_is_told_along_x() -> None:
    frame = frame_of_picture(np.full(SHAPE, 255, np.uint8))
    assert frame.axis == "x"
    assert frame.patches == ()


def test_any_other_picture_is_told_as_a_whole() -> None:
    picture = np.random.default_rng(5).integers(0, 256, SHAPE, dtype=np.uint8)
    frame = frame_of_picture(picture)
    np.testing.assert_array_equal(drawn(frame), picture)
    assert frame.image is not None
