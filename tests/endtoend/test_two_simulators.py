"""Two tracers and one decoder: POV-Ray's photos, decoded, against the coordinates of our own simulator."""

from pathlib import Path

import numpy as np
import pytest
from povray_judge import DATA
from scipy.ndimage import binary_erosion

from recon.sessions.importer import import_folder, read_layout
from recon.sessions.session import open_session
from recon.sweeps.correspondence import decode_sweep
from sim_backend.photography import Photographer
from sim_backend.scene import load_scene


@pytest.fixture(scope="module")
def smooth(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("smooth") / "session"
    import_folder(DATA / "smooth", folder, read_layout(DATA / "smooth.toml"))
    return folder


def test_decoded_photos_of_one_agree_with_the_coordinates_of_the_other(smooth: Path) -> None:
    session = open_session(smooth)
    scene = load_scene("povray_semi_ellipsoid")
    photographer = Photographer(scene)
    inside = binary_erosion(np.load(DATA / "truth.npz")["lit_in_all_sets"], iterations=5)
    for one in session.manifest.sets:
        ours = photographer.pixel_coordinates(
            stage_position_mm=scene.stage_positions_mm[one.position], wet=one.condition == "liquid"
        )
        for column, axis in enumerate(("x", "y")):
            difference = (decode_sweep(session, one, axis, method="full").place_px - ours[..., column])[inside]
            difference = difference[np.isfinite(difference)]
            rms = np.sqrt((difference**2).mean())
            median = np.median(np.abs(difference))
            print(f"{one.name}/{axis}: mean {difference.mean():+.5f} median {median:.5f} rms {rms:.5f} steps")
            assert len(difference) > 0.98 * inside.sum()
            assert abs(difference.mean()) <= 0.001
            assert median <= 0.01
            assert rms <= 0.03
