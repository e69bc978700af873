"""A thin cone on its flat back, traced by the simulator: one refraction beside both."""

import numpy as np
import pytest
from traced_session import traced_session

from recon.method import ThinForm
from recon.sessions.manifest import FlatFace
from recon.surface.thin_stage import FLAT_FACE, ONE_REFRACTION, thin_object
from recon.surface.thin_surface import NOTES
from sim_backend.scene import load_scene


def test_both_refractions_give_exact_normals_where_one_is_degrees_off() -> None:
    session = traced_session(load_scene("thin_cone").resized(camera_columns=64), noise_px=0.0, stated_sd_px=0.01)
    face = FlatFace(point_mm=(3.0, -2.0, 0.0), normal=(0.0, 0.0, 2.0))
    known = session.manifest.object.model_copy(update={"flat_face": face})
    truth = session.truth
    errors_deg = {}
    for name, manifest in (
        ("one", session.manifest),
        ("both", session.manifest.model_copy(update={"object": known})),
    ):
        result = thin_object(session.sweeps, manifest, method="full")
        assert result.warnings[-1] == (FLAT_FACE if name == "both" else ONE_REFRACTION)
        judged = result.maps.valid() & truth.judged
        assert judged.sum() > 500
        away = result.maps.normal[judged] - truth.normal[judged]
        errors_deg[name] = np.degrees(2 * np.arcsin(np.linalg.norm(away, axis=1) / 2))
        if name == "both":
            # The surface joins noise-free normals and crossings; what is left is chords across the apex of the cone.
            off = np.linalg.norm(result.maps.point_mm[judged] - truth.point_mm[judged], axis=1)
            assert np.median(off) < 0.01
    assert np.median(errors_deg["one"]) == pytest.approx(2.4, abs=0.2)
    assert errors_deg["both"].max() < 1e-6


@pytest.mark.parametrize("form", ["quadratic", "discrete", "bilateral"])
def test_normals_alone_give_the_cone_up_to_where_the_points_hold_it(form: ThinForm) -> None:
    session = traced_session(load_scene("thin_cone").resized(camera_columns=64), noise_px=0.0, stated_sd_px=0.01)
    face = FlatFace(point_mm=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0))
    known = session.manifest.object.model_copy(update={"flat_face": face})
    manifest = session.manifest.model_copy(update={"object": known})
    result = thin_object(session.sweeps, manifest, method="full", integration=form)
    assert NOTES[form] in result.warnings
    judged = result.maps.valid() & session.truth.judged
    away = (result.maps.point_mm - session.truth.point_mm)[judged]
    # A pixel sees 0.15; chords across the apex cut off a part of that.
    assert np.median(np.linalg.norm(away, axis=1)) < 0.01
