"""What a resumed session still holds: whole, missing, damaged, in doubt."""

import shutil
from pathlib import Path

import pytest
from rich.console import Console

from recon.sessions.session import SessionWriter, open_session
from rig.capturing.capture import capture
from rig.capturing.session_check import check_session, check_text
from rig.planning.plan import all_photos


@pytest.fixture
def session(captured: Path, tmp_path: Path) -> Path:
    """A whole session that a test may damage."""
    return Path(shutil.copytree(captured, tmp_path / "session"))


@pytest.fixture
def planned(config):
    return [photo.key for photo in all_photos(config)]


def test_a_whole_session_is_found_whole(session: Path, planned) -> None:
    heard: list[tuple[int, int]] = []
    found = check_session(open_session(session), on_photo=lambda done, total: heard.append((done, total)))
    assert found.whole == set(planned)
    assert (found.gone, found.damaged, found.in_doubt) == ((), (), ())
    assert heard == [(number, 72) for number in range(1, 73)]
    assert check_text(found, planned=planned) == ("72 of 72 photos are whole, 0 to be taken",)


def test_every_damage_is_told_apart(session: Path, planned) -> None:
    x = session / "photos/pos0_air/x"
    same_size = bytearray((x / "0001.jpg").read_bytes())
    same_size[100] ^= 1
    (x / "0001.jpg").write_bytes(same_size)
    (x / "0002.jpg").write_bytes(b"shorter")
    (x / "0003.jpg").unlink()
    (x / "0004.jpg.part").write_bytes(b"half")
    (session / "photos/pos0_air/extra.jpg").write_bytes(b"without a line")
    found = check_session(open_session(session))
    assert found.damaged == (("pos0_air", "x", 1), ("pos0_air", "x", 2))
    assert found.gone == (("pos0_air", "x", 3),)
    assert found.in_doubt == ("photos/pos0_air/extra.jpg", "photos/pos0_air/x/0004.jpg.part")
    assert found.whole == set(planned) - {("pos0_air", "x", number) for number in (1, 2, 3)}
    assert check_text(found, planned=planned) == (
        "69 of 72 photos are whole, 3 to be taken",
        "missing, though the journal names them: 1, such as pos0_air x 3",
        "damaged, not what the journal says: 2, such as pos0_air x 1",
        "in doubt, on disk without a line in the journal: 2, such as photos/pos0_air/extra.jpg",
    )


def test_the_photos_of_a_rejected_sweep_are_neither_whole_nor_in_doubt(session: Path) -> None:
    with SessionWriter.reopen(session) as writer:
        writer.reject_sweep("pos0_air", "x", reason="ripples")
    found = check_session(open_session(session))
    assert len(found.whole) == 72 - 8
    assert found.in_doubt == ()


def test_a_resumed_capture_says_what_it_found_and_makes_it_whole(
    session: Path, open_bench, config, scene, tmp_path: Path, captured: Path, read_photo_bytes
) -> None:
    (session / "photos/pos0_air/x/0003.jpg").write_bytes(b"half a photo")
    with (session / "journal.jsonl").open("ab") as file:
        file.write(b'{"event": "fill_started", "volume_ml": 4000.0}\n{"event": "photo", "set": "po')
    said = Console(record=True, soft_wrap=True, quiet=False, file=(tmp_path / "said.txt").open("w"))
    with open_bench(config, scene) as (devices, _):
        result = capture(config, session, devices=devices, scene=scene, resume=True, console=said)
    said.file.close()
    assert result.photos_taken == 1
    assert read_photo_bytes(session) == read_photo_bytes(captured)
    assert said.export_text().replace(f"{session}: ", "").splitlines()[:5] == [
        "71 of 72 photos are whole, 1 to be taken",
        "damaged, not what the journal says: 1, such as pos0_air x 3",
        "the last program ended without a word: it was killed, or the power went",
        "under way when it ended: a fill of 4000 ml",
        "not known from the journal: what the tank holds",
    ]
