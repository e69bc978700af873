"""The page on the session format is complete, and its worked example is a session."""

import ast
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel

from recon.maps import load_maps
from recon.run import run_session
from recon.running.settings import Settings
from recon.sessions import journal, manifest, pattern
from recon.sessions.journal import PhotoRecord
from recon.sessions.session import Session, open_session

REPOSITORY = Path(__file__).parents[2]
PAGE = (REPOSITORY / "docs/reference/session-format.md").read_text(encoding="utf-8")
PHOTOS = REPOSITORY / "tests/data/povray-semi-ellipsoid/smooth"

MODELS = {
    name: model
    for module in (manifest, pattern, journal)
    for name, model in vars(module).items()
    if isinstance(model, type) and issubclass(model, BaseModel) and model.__module__ == module.__name__
}
del MODELS["Part"]  # common behaviour, not a part of the file


def section(model_name: str) -> str:
    """Return the text under the heading of a model, up to the next heading."""
    found = re.search(rf"^### `{model_name}`:.*?$(.*?)(?=^##)", PAGE, re.MULTILINE | re.DOTALL)
    assert found is not None, f"docs/reference/session-format.md has no section on {model_name}"
    return found[1]


def rows(model_name: str) -> dict[str, list[str]]:
    """Return the section's table: field to its other cells."""
    cells = [line.strip("| ").split(" | ") for line in section(model_name).splitlines() if line.startswith("| `")]
    return {row[0].strip("` "): row[1:] for row in cells}


def journal_events(module: ast.Module) -> set[str]:
    """Return the names of events in calls such as ``writer.journal.append("sweep_started", ...)``."""
    calls = [node for node in ast.walk(module) if isinstance(node, ast.Call) and node.args]
    appends = [call for call in calls if ast.unparse(call.func).endswith("journal.append")]
    strings = [node for call in appends for node in ast.walk(call.args[0]) if isinstance(node, ast.Constant)]
    # "_started" alone is the constant end of f"{direction}_started".
    return {str(node.value) for node in strings if not str(node.value).startswith("_")}


def code_blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("model_name", MODELS)
def test_every_field_of_the_format_is_described_and_no_other(model_name: str) -> None:
    described = set(rows(model_name)) - {"event"}
    assert described == set(MODELS[model_name].model_fields)


@pytest.mark.parametrize("model_name", MODELS)
def test_a_field_is_said_to_be_required_exactly_where_the_parser_requires_it(model_name: str) -> None:
    fields = MODELS[model_name].model_fields
    said = {name for name, row in rows(model_name).items() if row[1] == "—"} - {"event"}
    assert said == {name for name, field in fields.items() if field.is_required()}


def test_every_event_that_the_rig_writes_is_described() -> None:
    sources = [path.read_text(encoding="utf-8") for path in (REPOSITORY / "rig").rglob("*.py")]
    written = set().union(*(journal_events(ast.parse(source)) for source in sources))
    assert {"capture_started", "came_to_rest", "sweep_started"} <= written
    assert {event for event in written if f"`{event}`" not in PAGE} == set()


@pytest.fixture(scope="module")
def written_by_hand(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Follow the page to the letter: save the manifest, run the loop."""
    folder = tmp_path_factory.mktemp("by hand")
    (folder / "smooth").symlink_to(PHOTOS)
    (folder / "session").mkdir()
    (folder / "session/manifest.json").write_text(code_blocks("json")[0], encoding="utf-8")
    script = code_blocks("bash")[0].replace("cp -r", "cp -rH")
    subprocess.run(["bash", "-euo", "pipefail", "-c", script], cwd=folder, check=True)
    return open_session(folder / "session")


def test_the_worked_example_is_a_session_with_all_its_photos(written_by_hand: Session) -> None:
    wanted = {
        (capture_set.name, sweep.axis, index)
        for capture_set in written_by_hand.manifest.sets
        for sweep in capture_set.sweeps
        for index in range(sweep.pattern.count)
    }
    assert wanted <= written_by_hand.photos.keys()
    assert all(written_by_hand.photo_file(*key).is_file() for key in wanted)


def test_the_journal_line_on_the_page_is_the_first_that_the_loop_writes(written_by_hand: Session) -> None:
    first = PhotoRecord.model_validate_json(code_blocks("json")[1].replace('"event": "photo", ', ""))
    assert first == written_by_hand.photos["pos0_air", "x", 0]


def test_the_session_written_by_hand_becomes_the_surface_of_the_ellipsoid(written_by_hand: Session) -> None:
    out = written_by_hand.folder.parent / "result"
    run_session(written_by_hand.folder, out, Settings(method="paper"))
    with np.load(PHOTOS.parent / "truth.npz") as truth:
        judged = truth["judged"]
    points = load_maps(out / "maps.npz").point_mm[judged]
    found = np.isfinite(points).all(axis=1)
    assert found.mean() > 0.9
    # x²/12.5² + y²/12.5² + z²/5² = 1; the distance to first order, against a stripe step of 1/6 unit on the display.
    squares = np.array([12.5, 12.5, 5.0]) ** 2
    level = (points[found] ** 2 / squares).sum(axis=1) - 1
    distance = level / np.linalg.norm(2 * points[found] / squares, axis=1)
    assert np.median(np.abs(distance)) < 1 / 6
