"""What every display owes the rig. The bench's panel has 64 × 64 device pixels."""

import numpy as np
import pytest

from drivers.errors import DeviceProtocolError, DeviceTimeoutError
from drivers.protocols import Frame, Patch

WHITE = Frame(axis="x", levels=np.full(64, 255, np.uint8))


def test_a_frame_is_on_the_glass_when_show_returns(open_display) -> None:
    with open_display() as bench:
        assert (bench.device.screen().columns, bench.device.screen().rows) == (64, 64)
        patch = Patch(60, 60, np.full((4, 4), 200, np.uint8))
        frame = Frame(axis="y", levels=np.arange(64, dtype=np.uint8), patches=(patch,))
        bench.device.show(frame, frame_id=7, timeout_s=5.0)
        sight = bench.world.look()
        assert sight.frame_id == 7
        assert sight.frame.axis == "y"
        np.testing.assert_array_equal(sight.frame.levels, np.arange(64))
        np.testing.assert_array_equal(sight.frame.patches[0].levels, patch.levels)


@pytest.mark.parametrize(
    "frame",
    [
        Frame(),
        Frame(axis="x", levels=np.zeros(63, np.uint8)),
        Frame(axis="y", levels=np.zeros(65, np.uint8)),
        Frame(image=np.zeros((64, 63), np.uint8)),
        Frame(axis="x", levels=np.zeros(64, np.uint8), image=np.zeros((64, 64), np.uint8)),
        Frame(axis="x", levels=np.zeros(64, np.uint8), patches=(Patch(61, 0, np.zeros((4, 4), np.uint8)),)),
        Frame(axis="x", levels=np.zeros(64, np.uint8), patches=(Patch(0, -1, np.zeros((4, 4), np.uint8)),)),
    ],
)
def test_a_frame_that_does_not_fit_is_refused_and_the_last_one_stays(open_display, frame: Frame) -> None:
    with open_display() as bench:
        bench.device.show(WHITE, frame_id=1, timeout_s=5.0)
        with pytest.raises(DeviceProtocolError):
            bench.device.show(frame, frame_id=2, timeout_s=5.0)
        assert bench.world.look().frame_id == 1


def test_a_display_that_is_too_slow_says_so_and_does_not_pretend(open_display) -> None:
    with open_display() as bench:
        bench.device.show(WHITE, frame_id=1, timeout_s=5.0)
        with pytest.raises(DeviceTimeoutError):
            bench.device.show(WHITE, frame_id=2, timeout_s=0.001)
        assert bench.world.look().frame_id == 1


def test_the_glass_is_dark_after_leaving(open_display) -> None:
    with open_display() as bench:
        bench.device.show(WHITE, frame_id=1, timeout_s=5.0)
    levels = bench.world.look().frame.levels
    assert levels is not None
    assert not levels.any()


@pytest.mark.without_world
def test_a_display_confirms_what_fits_its_own_panel_and_refuses_the_rest(open_display) -> None:
    with open_display() as bench:
        columns = bench.device.screen().columns
        bench.device.show(Frame(axis="x", levels=np.full(columns, 255, np.uint8)), frame_id=1, timeout_s=5.0)
        with pytest.raises(DeviceProtocolError):
            bench.device.show(Frame(axis="x", levels=np.zeros(columns + 1, np.uint8)), frame_id=2, timeout_s=5.0)
