"""Where a code leaves pixels in doubt, the rows and columns that a sweep should go over are named."""

import numpy as np

from recon.sessions.pattern import GrayLinePattern
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.doubtful_ranges import doubtful_ranges
from recon.sweeps.noise import NoiseModel

LINES = GrayLinePattern(
    kind="gray_line", profile="hard", width_px=4.0, first_px=0.0, step_px=1.0, period_px=16.0, places=1024
)


def result(status: np.ndarray) -> SweepResult:
    """Return a sweep in which column c of the photo looks at place 10 c, wherever it has a place."""
    place_px = np.where(status == PixelStatus.OK, 10.0 * np.arange(100) + np.zeros((40, 1)), np.nan)
    sd = np.full(status.shape, 0.01, np.float32)
    return SweepResult(place_px, sd, status, NoiseModel(1.0), 1.0, (), ())


def ranges(status: np.ndarray, pattern: object = LINES) -> list[tuple[int, int, int]]:
    found = doubtful_ranges(result(status), pattern, set_name="pos0_air", axis="x", device_px=1024)
    assert all((one.set, one.axis) == ("pos0_air", "x") for one in found)
    return [(one.first_px, one.last_px, one.pixels) for one in found]


def test_two_patches_in_doubt_are_two_ranges_a_period_wider_than_their_neighbours() -> None:
    status = np.zeros((40, 100), np.uint8)
    status[10:20, 30:33] = PixelStatus.BAD_CODE
    status[5:35, 60] = PixelStatus.BAD_FIT
    # The nearest pixels with a place are in columns 29 and 33 (or above and below), and in columns 59 or 61.
    first, second = ranges(status)
    assert first == (290 - 16, 330 + 16, 30)
    assert second[0] in (590 - 16, 600 - 16)
    assert second[1] in (610 + 16, 600 + 16)
    assert second[2] == 30


def test_a_few_stray_pixels_and_a_dark_surround_are_worth_no_sweep() -> None:
    status = np.full((40, 100), PixelStatus.UNLIT, np.uint8)
    status[:, 20:80] = PixelStatus.OK
    status[3, 40:45] = PixelStatus.BAD_CODE
    status[:, 95:] = PixelStatus.BAD_FIT  # 16 photo pixels from any place
    assert ranges(status) == []


def test_a_sweep_is_not_to_be_swept_again() -> None:
    status = np.zeros((40, 100), np.uint8)
    status[10:20, 30:33] = PixelStatus.BAD_FIT
    assert ranges(status, LINES.as_sweep()) == []
