"""Only what changed is made again, and what is kept is what would be made."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from batch_example import EQUAL_FILES, hashes, simulate_one

from recon.method import Limits
from recon.metrics import METRICS_NAME, Metrics, load_metrics
from recon.report.rewrite import rewrite_report
from recon.run import decode_session, run_session
from recon.running.kept_outcome import kept_outcome, outcome_key
from recon.running.kept_stages import KEPT_NAME
from recon.running.outcome import reconstruct
from recon.running.settings import Settings
from recon.sessions.session import open_session

ALL = {
    "decode the photos",
    "points, normals and surface",
    "write maps, cloud and mesh",
    "compare the reference photos",
    "report",
}
USUAL = Settings(threads=1)
STRICT = dataclasses.replace(USUAL, limits=Limits(gap_sigma=0.5))


def kept_of(metrics: Metrics) -> set[str]:
    return {stage.name for stage in metrics.stages if stage.kept}


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A session and the results of its first run, in which nothing could be kept."""
    folder = tmp_path_factory.mktemp("kept")
    simulate_one(folder / "session", scene_name="semi_ellipsoid", size=48, display_columns=96, seed=1)
    metrics = run_session(folder / "session", folder / "result", USUAL)
    assert kept_of(metrics) == set()
    return folder / "session", folder / "result"


@pytest.fixture
def again(first: tuple[Path, Path], tmp_path: Path) -> tuple[Path, Path]:
    """A copy of both, to be changed."""
    return tuple(Path(shutil.copytree(folder, tmp_path / folder.name)) for folder in first)  # type: ignore[return-value]


def test_the_same_run_again_keeps_every_stage_and_every_byte_and_its_numbers_say_so(again: tuple[Path, Path]) -> None:
    session, result = again
    files = (*EQUAL_FILES, "report.html", KEPT_NAME)
    before = hashes(result, files)
    numbers = load_metrics(result / METRICS_NAME)
    metrics = run_session(session, result, USUAL)
    assert kept_of(metrics) == ALL
    assert hashes(result, files) == before
    assert kept_of(load_metrics(result / METRICS_NAME)) == ALL
    assert metrics.model_copy(update={"stages": ()}) == numbers.model_copy(update={"stages": ()})


def test_another_threshold_decodes_nothing_and_comes_to_what_a_run_by_force_does(again: tuple[Path, Path]) -> None:
    session, result = again
    before = hashes(result)
    assert kept_of(run_session(session, result, STRICT)) == {"decode the photos"}
    after = hashes(result)
    assert after["maps.npz"] != before["maps.npz"]
    assert kept_of(run_session(session, result, dataclasses.replace(STRICT, force=True))) == set()
    assert hashes(result) == after


@pytest.mark.parametrize("file", ["maps.npz", "mesh.ply"])
def test_a_damaged_result_is_made_again(again: tuple[Path, Path], file: str) -> None:
    session, result = again
    before = hashes(result)
    (result / file).write_bytes((result / file).read_bytes()[:-1])
    assert kept_of(run_session(session, result, USUAL)) == ALL - {
        "points, normals and surface",
        "write maps, cloud and mesh",
    }
    assert hashes(result) == before


def test_a_kept_outcome_is_the_one_that_was_made_but_for_the_precision_of_the_mesh(again: tuple[Path, Path]) -> None:
    session, sweeps = open_session(again[0]), decode_session(open_session(again[0]), USUAL)
    made = reconstruct(session, sweeps, USUAL)
    kept = kept_outcome(again[1], outcome_key(session, sweeps, USUAL))
    assert kept is not None
    assert kept.mesh is not None
    for field in dataclasses.fields(made):
        if field.name not in ("maps", "mesh"):
            assert getattr(kept, field.name) == getattr(made, field.name), field.name
    for name in ("point_mm", "normal", "sd_mm", "gap_mm", "pbc_angle_rad", "status"):
        np.testing.assert_array_equal(getattr(kept.maps, name), getattr(made.maps, name))
    np.testing.assert_array_equal(kept.mesh.faces, made.mesh.faces)
    np.testing.assert_array_equal(kept.mesh.vertices_mm, made.mesh.vertices_mm.astype(np.float32))


def test_a_mask_a_pose_and_the_program_are_inputs_of_the_surface(
    again: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, _ = again
    sweeps = decode_session(open_session(folder), USUAL)
    keys = [outcome_key(open_session(folder), sweeps, USUAL)]
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["display_poses"][0]["centre_mm"][0] += 0.001
    manifest["mask"] = "mask.png"
    for mask in (b"one", b"another"):
        (folder / "mask.png").write_bytes(mask)
        (folder / "manifest.json").write_text(json.dumps(manifest))
        keys.append(outcome_key(open_session(folder), sweeps, USUAL))
    monkeypatch.setattr("recon.running.kept_outcome.program_hash", lambda: "another program")
    keys.append(outcome_key(open_session(folder), sweeps, USUAL))
    assert len(set(keys)) == 4


def test_an_evaluation_in_the_report_outlives_a_run_that_changes_nothing(again: tuple[Path, Path]) -> None:
    session, result = again
    rewrite_report(result, [{"of": "sphere", "quantity": "radius", "ours": 1.25, "published": "", "unit": "mm"}])
    report = (result / "report.html").read_bytes()
    assert kept_of(run_session(session, result, USUAL)) == ALL
    assert (result / "report.html").read_bytes() == report
