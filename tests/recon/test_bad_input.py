"""Whatever is wrong with a session, the person reads one sentence, the exit code is not 0, and nothing is lost."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command_run import Done, one_sentence
from session_example import manifest, write_session


def test_the_installed_program_refuses_like_the_function_in_these_tests(tmp_path: Path) -> None:
    program = Path(sys.executable).with_name("recon")
    done = subprocess.run([program, "run", tmp_path], capture_output=True, text=True, timeout=300, check=False)
    assert "no manifest.json here" in one_sentence(Done(done.returncode, done.stdout, done.stderr))


def changed(**fields: Any) -> dict[str, Any]:
    return {**manifest(), **fields}


def poses(*heights: object) -> list[dict[str, Any]]:
    return [{"centre_mm": [0.0, 0.0, z], "x_axis": [1, 0, 0], "y_axis": [0, 1, 0]} for z in heights]


MANIFESTS: list[tuple[str, dict[str, Any], str]] = [
    ("unknown schema version", changed(schema_version=7), "schema_version is 7, this program reads 1"),
    ("poses that coincide", changed(display_poses=poses(10.0, 10.0)), "two display positions coincide"),
    ("a NaN in the geometry", changed(display_poses=poses(10.0, float("nan"))), "display_poses.1.centre_mm.2"),
    ("an absolute path", changed(mask="/etc/passwd"), "must be a path inside the session"),
    ("a path that climbs out", changed(mask="../mask.png"), "must be a path inside the session"),
    ("a field nobody knows", changed(displya={}), "displya"),
    ("a set too few", changed(sets=manifest()["sets"][:3]), "sets"),
]


@pytest.mark.parametrize(("fields", "expected"), [case[1:] for case in MANIFESTS], ids=[case[0] for case in MANIFESTS])
def test_a_bad_manifest_is_refused(
    tmp_path: Path, fields: dict[str, Any], expected: str, refusal: Callable[..., str]
) -> None:
    session = write_session(tmp_path / "session", fields=fields)
    for command in ("run", "validate"):
        assert expected in refusal(command, session)


def drop_photo(session: Path) -> None:
    (session / "photos/pos0_air/x/0002.jpg").unlink()


def truncate_photo(session: Path) -> None:
    path = session / "photos/pos0_air/x/0002.jpg"
    path.write_bytes(path.read_bytes()[:150])


def empty_photo(session: Path) -> None:
    (session / "photos/pos0_air/x/0002.jpg").write_bytes(b"")


def resize_photo(session: Path) -> None:
    import numpy as np
    import simplejpeg

    picture = simplejpeg.encode_jpeg(np.zeros((8, 8, 1), np.uint8), colorspace="GRAY")
    (session / "photos/pos0_air/x/0002.jpg").write_bytes(picture)


def make_a_hole(session: Path) -> None:
    journal = session / "journal.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(line for line in lines if "pos1_liquid/y/0003" not in line))


def climb_out(session: Path) -> None:
    journal = session / "journal.jsonl"
    journal.write_text(journal.read_text().replace("photos/pos0_air/x/0000.jpg", "../secret.jpg"))


def spoil_journal(session: Path) -> None:
    journal = session / "journal.jsonl"
    journal.write_text("not json\n" + journal.read_text())


PHOTOS: list[tuple[Callable[[Path], None], str]] = [
    (drop_photo, "0002.jpg: the journal names this photo, but it is missing"),
    (truncate_photo, "0002.jpg: "),
    (empty_photo, "0002.jpg: "),
    (resize_photo, "the manifest says 16 x 12"),
    (make_a_hole, "pos1_liquid/y: photo 3 of 5 missing"),
    (climb_out, "must be a path inside the session"),
    (spoil_journal, "line 1: not JSON"),
]


@pytest.mark.parametrize(("spoil", "expected"), PHOTOS, ids=[case[0].__name__ for case in PHOTOS])
def test_a_spoilt_session_is_refused_by_the_file_that_is_wrong(
    tmp_path: Path,
    spoil: Callable[[Path], None],
    expected: str,
    refusal: Callable[..., str],
    recon: Callable[..., Done],
) -> None:
    session = write_session(tmp_path / "session")
    spoil(session)
    assert expected in refusal("run", session)
    checked = recon("validate", session)
    assert checked.returncode != 0
    assert expected in checked.stdout + checked.stderr
    assert "Traceback" not in checked.stdout + checked.stderr


def test_a_sound_session_is_called_sound(tmp_path: Path, recon: Callable[..., Done]) -> None:
    done = recon("validate", write_session(tmp_path / "session"))
    assert done.returncode == 0
    assert "sound" in done.stdout
    assert "no sha256" in done.stdout


def test_validate_notices_a_photo_that_was_changed_afterwards(tmp_path: Path, recon: Callable[..., Done]) -> None:
    session = write_session(tmp_path / "session")
    journal = session / "journal.jsonl"
    first = json.loads(journal.read_text().splitlines()[0])
    wrong = json.dumps({**first, "sha256": "0" * 64})
    journal.write_text("\n".join([wrong, *journal.read_text().splitlines()[1:]]) + "\n")
    done = recon("validate", session)
    assert done.returncode == 1
    assert f"{first['file']}: its sha256 is not the journal's" in done.stdout


def test_an_empty_folder_and_a_folder_that_is_not_there(tmp_path: Path, refusal: Callable[..., str]) -> None:
    (tmp_path / "empty").mkdir()
    assert "no manifest.json here" in refusal("run", tmp_path / "empty")
    assert "no such folder" in refusal("run", tmp_path / "nowhere")
    assert "no manifest.json here" in refusal("validate", tmp_path / "empty")


def test_results_that_cannot_be_written_say_so_and_leave_the_session_alone(
    tmp_path: Path, refusal: Callable[..., str]
) -> None:
    session = write_session(tmp_path / "session")
    before = sorted(path.name for path in session.rglob("*"))
    (tmp_path / "file").write_text("in the way")
    assert "cannot be written" in refusal("run", session, "--out", tmp_path / "file" / "out")
    assert sorted(path.name for path in session.rglob("*")) == before


def test_results_are_not_written_among_the_files_of_a_session(tmp_path: Path, refusal: Callable[..., str]) -> None:
    session = write_session(tmp_path / "session")
    before = sorted(path.name for path in session.rglob("*"))
    assert "--out is the folder of a session" in refusal("run", session, "--out", session)
    assert sorted(path.name for path in session.rglob("*")) == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, which only Linux has")
def test_a_full_disk_is_one_sentence(tmp_path: Path, refusal: Callable[..., str]) -> None:
    session = write_session(tmp_path / "session")
    out = tmp_path / "out"
    out.mkdir()
    os.symlink("/dev/full", out / "maps.npz")
    assert "No space left on device" in refusal("run", session, "--out", out)


def test_a_person_who_stops_a_run_is_told_that_the_session_is_as_it_was(
    tmp_path: Path, refusal: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_arguments: object, **_settings: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("recon.run.run_session", stopped)
    message = refusal("run", write_session(tmp_path / "session"), "--out", tmp_path / "out")
    assert message == "recon: stopped; nothing of the session was changed"


def test_an_integration_of_thin_objects_is_refused_for_a_session_with_liquid(
    tmp_path: Path, refusal: Callable[..., str]
) -> None:
    session = write_session(tmp_path / "session")
    message = refusal("run", session, "--out", tmp_path / "out", "--integration", "bilateral")
    assert "--integration bilateral is for thin objects, and this session's method is 'liquid'" in message
    assert not (tmp_path / "out").exists()


def test_a_torn_last_line_of_the_journal_is_no_fault(tmp_path: Path, recon: Callable[..., Done]) -> None:
    session = write_session(tmp_path / "session")
    with (session / "journal.jsonl").open("a") as journal:
        journal.write('{"event": "photo", "set": "pos0_')
    assert recon("validate", session).returncode == 0


LAYOUTS: list[tuple[str, str]] = [
    ("not = [toml", "not TOML"),
    ('name = "a"\n', "[pattern] is missing"),
    (
        'name = "a"\n[pattern]\nprofile = "hard"\nwidth_px = 1\nfirst_px = 0\nstep_px = 1\ncount = 5\n',
        "layout.toml: object: is missing",
    ),
]


@pytest.mark.parametrize(("text", "expected"), LAYOUTS)
def test_a_layout_that_cannot_be_used_is_refused(
    tmp_path: Path, text: str, expected: str, refusal: Callable[..., str]
) -> None:
    (tmp_path / "layout.toml").write_text(text)
    message = refusal("import", tmp_path, tmp_path / "session", "--layout", tmp_path / "layout.toml")
    assert expected in message
    assert not (tmp_path / "session").exists()


def test_an_import_with_a_missing_photo_leaves_nothing_behind(tmp_path: Path, refusal: Callable[..., str]) -> None:
    layout = Path(__file__).parents[1] / "data" / "povray-semi-ellipsoid" / "hard.toml"
    (tmp_path / "photos").mkdir()
    message = refusal("import", tmp_path / "photos", tmp_path / "session", "--layout", layout)
    assert "1544 photos not found" in message
    assert not (tmp_path / "session").exists()
