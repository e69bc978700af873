"""What the eight sweeps of a session say together of each pixel."""

from dataclasses import replace

import numpy as np
import pytest

from recon.sessions.manifest import CaptureSet, Manifest
from recon.status import PixelStatus as Status
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.noise import NoiseModel
from recon.sweeps.set_places import AXES, combined_status, path_count
from tests.recon.session_example import manifest

# What the sweeps along x and y of the first two sets say, the others being sound, and what follows for the pixel.
PIXELS = (
    ((Status.OK, Status.OK, Status.OK, Status.OK), Status.OK, 1),
    ((Status.UNLIT, Status.UNLIT, Status.OK, Status.OK), Status.PARTLY_LIT, 1),
    ((Status.UNLIT, Status.BAD_FIT, Status.TWO_PATHS, Status.OK), Status.PARTLY_LIT, 2),
    ((Status.TWO_PATHS, Status.OK, Status.OK, Status.BAD_FIT), Status.BAD_FIT, 2),
    ((Status.HALF_SEEN, Status.OK, Status.OK, Status.OK), Status.HALF_SEEN, 1),
    ((Status.HALF_SEEN, Status.HALF_SEEN, Status.OK, Status.TWO_PATHS), Status.HALF_SEEN, 2),
    ((Status.OK, Status.SWEEP_EDGE, Status.BAD_FIT, Status.OK), Status.SWEEP_EDGE, 1),
)


def sweeps_of(sets: list[CaptureSet]) -> dict[tuple[str, str], SweepResult]:
    """Return sweeps of these pixels, and of one more that no sweep lit."""
    blank = np.zeros((1, len(PIXELS) + 1))
    result = SweepResult(blank, blank.astype(np.float32), blank.astype(np.uint8), NoiseModel(1.0), np.nan, (), ())
    found = {}
    for number, key in enumerate((one.name, axis) for one in sets for axis in AXES):
        said = [told[number] if number < len(told) else Status.OK for told, _, _ in PIXELS]
        found[key] = replace(result, status=np.array([[*said, Status.UNLIT]], np.uint8))
    return found


@pytest.fixture
def sets() -> list[CaptureSet]:
    return list(Manifest.model_validate(manifest()).sets)


def test_the_reason_that_explains_most_counts(sets: list[CaptureSet]) -> None:
    status = combined_status(sweeps_of(sets), sets)
    assert [Status(one) for one in status] == [*(reason for _, reason, _ in PIXELS), Status.UNLIT]


def test_a_pixel_has_two_paths_where_any_sweep_saw_two_and_none_where_no_sweep_lit_it(sets: list[CaptureSet]) -> None:
    assert path_count(sweeps_of(sets)).ravel().tolist() == [*(paths for _, _, paths in PIXELS), 0]
