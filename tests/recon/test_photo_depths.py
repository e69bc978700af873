"""Photos of a set that have different bits a sample, of which one would be read as a share of the other's range."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_run import Done
from session_example import COLS, ROWS, manifest, write_session


def test_photos_of_different_depths_in_a_set_are_refused(
    tmp_path: Path, refusal: Callable[..., str], recon: Callable[..., Done]
) -> None:
    session = write_session(tmp_path / "session")
    deepen([session / "photos/pos0_air/x/0002.jpg"])
    message = refusal("run", session, "--out", tmp_path / "out")
    assert "8 bits a sample, but other photos of the set have 16" in message
    checked = recon("validate", session)
    assert checked.returncode == 1
    assert "x/0002.jpg: 16 bits a sample, but most photos of the sweep have 8" in checked.stdout


def deepen(photos: Iterable[Path]) -> None:
    """Write photos again with 16 bits a sample."""
    for photo in photos:
        counts = 257 * cv2.imread(str(photo), cv2.IMREAD_UNCHANGED).astype(np.uint16)
        photo.write_bytes(cv2.imencode(".png", counts)[1].tobytes())


STRIPE = manifest()["sets"][0]["sweeps"][0]["pattern"]
PATTERNS: list[tuple[dict[str, Any], int]] = [
    (STRIPE, 5),
    # Four shifts of the lines, and five places are three half periods of two: two bits, each with its inverse.
    (
        {key: STRIPE[key] for key in ("profile", "width_px", "first_px", "step_px")}
        | {"kind": "gray_line", "period_px": 4, "places": 5},
        8,
    ),
    ({"kind": "phase_shift", "periods_px": [6], "steps": 4, "first_px": 0, "last_px": 4}, 4),
]


@pytest.mark.parametrize(("pattern", "photos"), PATTERNS, ids=["stripe", "gray_line", "phase_shift"])
def test_a_black_photo_of_another_depth_is_refused_whatever_the_pattern(
    tmp_path: Path, pattern: dict[str, Any], photos: int, refusal: Callable[..., str], recon: Callable[..., Done]
) -> None:
    sets = [
        {**one, "sweeps": [{"axis": axis, "pattern": pattern} for axis in ("x", "y")]} for one in manifest()["sets"]
    ]
    session = write_session(tmp_path / "session", fields={**manifest(), "sets": sets}, photos=photos)
    deepen(session.rglob("*.jpg"))
    black = session / "photos/pos0_air/black.png"
    black.write_bytes(cv2.imencode(".png", np.zeros((ROWS, COLS), np.uint8))[1].tobytes())
    line = {"event": "photo", "set": "pos0_air", "sweep": "black", "index": 0, "file": "photos/pos0_air/black.png"}
    with (session / "journal.jsonl").open("a") as journal:
        journal.write(json.dumps(line) + "\n")
    message = refusal("run", session, "--out", tmp_path / "out")
    assert f"x/0000.jpg: 16 bits a sample, but {black} has 8; convert them to the same depth" in message
    checked = recon("validate", session)
    assert checked.returncode == 1
    assert "photos/pos0_air/black.png: 8 bits a sample, but most photos of the set have 16" in checked.stdout
