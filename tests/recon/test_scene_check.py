"""Reference photos taken in one after the other: what is compared with what, and in which pixels the answer is given."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from report_example import example_manifest

from recon.errors import SessionError
from recon.scene.scene_change import SceneLimits, SceneParts
from recon.scene.scene_check import (
    NO_MARKS,
    NO_REFERENCES,
    ONE_REFERENCE,
    SceneChecker,
    check_scene,
    parts_of_session,
    reduction,
)
from recon.sessions.journal import JOURNAL_NAME
from recon.sessions.session import MANIFEST_NAME, SessionWriter, open_session

LIMITS = SceneLimits(shift_px=0.05, sigmas=6.0, light_share=0.02)
MARKS = SceneParts(marks_px=((0.0, 0.0, 60.0, 60.0),))
ROWS, COLUMNS = 180, 240


def waves(rows: int, columns: int, *, shift_px: float = 0.0, finest_px: float = 8.0) -> np.ndarray:
    """Forty plane waves of at least ``finest_px``, moved along x."""
    row, column = np.mgrid[0:rows, 0:columns].astype(np.float64)
    draws = np.random.default_rng(4).uniform((1, 0, 0), (6, 2 * np.pi, 2 * np.pi), (40, 3))
    total = np.full((rows, columns), 120.0)
    for stretch, turn, phase in draws:
        k = 2 * np.pi / (finest_px * stretch)
        total += 9 * np.cos(k * (np.cos(turn) * (column - shift_px) + np.sin(turn) * row) + phase)
    return total


def photo(picture: np.ndarray, seed: int, sd: float = 1.5) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0, sd, picture.shape)
    return np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)


def checker(parts: SceneParts = MARKS, rows: int = ROWS, columns: int = COLUMNS) -> SceneChecker:
    return SceneChecker(parts, LIMITS, rows=rows, columns=columns)


def test_each_photo_is_compared_with_the_first_of_its_set_and_sets_with_the_first_of_all() -> None:
    still, moved = waves(ROWS, COLUMNS), waves(ROWS, COLUMNS, shift_px=0.4)
    watch = checker()
    assert watch.see("pos0_air", 0, photo(still, 1), wet=False) is None
    second = watch.see("pos0_air", 1, photo(still, 2), wet=False)
    assert second is not None
    assert (second.across_sets, second.findings) == (False, ())
    assert set(second.parts) == {"marks", "display"}
    across = watch.see("pos1_air", 0, photo(moved, 3), wet=False)
    assert across is not None
    assert across.across_sets
    # Only the marks may be compared between sets.
    assert set(across.parts) == {"marks"}
    assert across.parts["marks"].shift_px[0] == pytest.approx(0.4, abs=0.02)
    assert [found.cause for found in across.findings] == ["camera or object"]
    within = watch.see("pos1_air", 1, photo(moved, 4), wet=False)
    assert within is not None
    assert within.findings == ()


def test_sets_are_not_compared_without_marks() -> None:
    still = waves(ROWS, COLUMNS)
    watch = checker(SceneParts())
    for number in range(2):
        watch.see("pos0_air", number, photo(still, number), wet=False)
    assert watch.see("pos1_air", 0, photo(still, 5), wet=False) is None


def test_a_large_photo_is_measured_smaller_and_told_in_its_own_pixels() -> None:
    rows, columns = 600, 2400
    assert reduction(columns) == 2
    watch = checker(SceneParts(), rows, columns)
    pictures = [waves(rows, columns, shift_px=shift, finest_px=16.0) for shift in (0.0, 0.0, 0.5)]
    *_, found = [watch.see("pos0_air", n, photo(picture, n), wet=False) for n, picture in enumerate(pictures)]
    assert found is not None
    display = found.parts["display"]
    assert display.shift_px[0] == pytest.approx(0.5, abs=0.01)
    assert display.shift_px[1] == pytest.approx(0.0, abs=5 * display.sd_px[1])


def test_clipped_pixels_are_left_out() -> None:
    glare = np.zeros((ROWS, COLUMNS))
    cv2.circle(glare, (160, 90), 40, 400.0, -1)
    watch = checker(SceneParts())
    for number in range(2):
        watch.see("pos0_air", number, photo(waves(ROWS, COLUMNS) + glare, number), wet=False)
    found = watch.see("pos0_air", 2, photo(waves(ROWS, COLUMNS, shift_px=0.3) + glare, 9), wet=False)
    assert found is not None
    # The glare stands still and would drag the shift down if it counted.
    assert found.parts["display"].shift_px[0] == pytest.approx(0.3, abs=0.02)


def test_two_photos_in_a_row_are_still_only_when_nothing_moved_between_them() -> None:
    watch = checker(SceneParts())
    still = waves(ROWS, COLUMNS)
    for number in range(2):
        watch.see("pos0_air", number, photo(still, number), wet=False)
    assert watch.is_still(photo(still, 5), photo(still, 6))
    assert not watch.is_still(photo(still, 5), photo(waves(ROWS, COLUMNS, shift_px=0.04), 6))
    assert not watch.is_still(photo(still, 5), photo(0.97 * still, 6))


def session_with(folder: Path, photos: int, *, event: dict | None = None) -> None:
    with SessionWriter.create(folder, example_manifest()) as writer:
        if event is not None:
            writer.journal.append("watch_started", **event)
        for index in range(photos):
            data = cv2.imencode(".png", photo(waves(ROWS, COLUMNS), index))[1].tobytes()
            writer.save_photo(data, set_name="pos0_air", sweep="reference", index=index, suffix=".png")


def test_a_session_says_what_could_not_be_checked(tmp_path: Path) -> None:
    for photos, note in ((0, NO_REFERENCES), (1, ONE_REFERENCE), (3, NO_MARKS)):
        folder = tmp_path / str(photos)
        session_with(folder, photos)
        report = check_scene(open_session(folder))
        assert report.note == note
        assert len(report.checks) == max(0, photos - 1)


def test_parts_and_limits_are_those_that_the_journal_last_tells(tmp_path: Path) -> None:
    event = {"object_px": [[1, 2], [30, 2], [30, 40]], "marks_px": [[0, 0, 60, 60]], "shift_px": 0.1, "sigmas": 8}
    session_with(tmp_path / "s", 2, event=event)
    parts, limits = parts_of_session(open_session(tmp_path / "s"))
    assert parts.object_px == ((1.0, 2.0), (30.0, 2.0), (30.0, 40.0))
    assert (limits.shift_px, limits.sigmas, limits.light_share) == (0.1, 8.0, 0.02)
    assert check_scene(open_session(tmp_path / "s")).note == ""


def test_parts_that_are_none_are_refused_in_a_sentence(tmp_path: Path) -> None:
    session_with(tmp_path / "s", 2, event={"marks_px": [[0, 0, 60]]})
    with pytest.raises(SessionError, match=r"watch_started needs object_px as pairs and marks_px as fours"):
        check_scene(open_session(tmp_path / "s"))
    assert (tmp_path / "s" / MANIFEST_NAME).is_file()
    assert json.loads((tmp_path / "s" / JOURNAL_NAME).read_text().splitlines()[0])["event"] == "watch_started"
