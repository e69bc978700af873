"""Raw photos: the written samples of one colour come back, and nothing of their neighbours."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from dng import BLUE, GREEN, RED, dng_bytes
from session_example import COLS, ROWS, write_session

from recon.errors import SessionError
from recon.sessions.photos import decode_grey, read_grey, saturation_count
from recon.sessions.session import open_session
from recon.sessions.wholeness import faults

WHITE = 16383
LAYOUTS = [(RED, GREEN, GREEN, BLUE), (BLUE, GREEN, GREEN, RED), (GREEN, RED, BLUE, GREEN)]


@pytest.fixture
def _libraw(require_module: Callable[[str, str], ModuleType]) -> None:
    require_module("rawpy", "'refractive-scan[raw]'")


def mosaic(rows: int = 24, cols: int = 36) -> np.ndarray:
    return np.random.default_rng(7).integers(200, WHITE, (rows, cols)).astype(np.uint16)


@pytest.mark.usefixtures("_libraw")
@pytest.mark.parametrize("colours", LAYOUTS)
@pytest.mark.parametrize(("primary", "colour"), [("red", RED), ("green", GREEN), ("blue", BLUE), ("white", GREEN)])
def test_a_plane_holds_the_samples_of_its_colour_alone(
    colours: tuple[int, int, int, int], primary: str, colour: int
) -> None:
    written = mosaic()
    others = np.tile(np.array(colours).reshape(2, 2) != colour, (12, 18))
    counts = decode_grey(dng_bytes(written, colours=colours), Path("a.dng"), primary=primary)
    blocks = written.reshape(12, 2, 18, 2).transpose(0, 2, 1, 3).reshape(12, 18, 4)[..., np.array(colours) == colour]
    np.testing.assert_allclose(counts, blocks.mean(axis=2) * 65535 / WHITE, atol=0.5 + 1e-9)
    changed = np.where(others, WHITE - 1, written).astype(np.uint16)
    np.testing.assert_array_equal(
        decode_grey(dng_bytes(changed, colours=colours), Path("a.dng"), primary=primary), counts
    )


@pytest.mark.usefixtures("_libraw")
def test_a_clipped_green_sample_makes_its_pixel_clipped_and_no_other() -> None:
    written = np.minimum(mosaic(), WHITE - 1)
    written[0, 1], written[3, 2] = WHITE, WHITE
    counts = decode_grey(dng_bytes(written), Path("a.dng"), primary="green")
    clipped = np.zeros(counts.shape, dtype=bool)
    clipped[0, 0] = clipped[1, 1] = True
    np.testing.assert_array_equal(counts >= saturation_count(counts), clipped)


@pytest.mark.usefixtures("_libraw")
def test_a_raw_file_that_is_cut_off_is_refused_in_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "cut.dng"
    path.write_bytes(dng_bytes(mosaic())[:-600])
    with pytest.raises(SessionError, match=r"cut\.dng: the raw photo cannot be decoded .* take it again"):
        read_grey(path, rows=12, cols=18, primary="green")


@pytest.mark.usefixtures("_libraw")
def test_a_session_of_raw_photos_is_sound_at_half_the_sensors_size(tmp_path: Path) -> None:
    folder = write_session(tmp_path / "session")
    journal = (folder / "journal.jsonl").read_text().replace(".jpg", ".dng")
    (folder / "journal.jsonl").write_text(journal)
    for number, photo in enumerate(sorted((folder / "photos").rglob("*.jpg"))):
        photo.unlink()
        samples = mosaic(2 * ROWS, 2 * COLS)
        samples[0, 0] = number
        photo.with_suffix(".dng").write_bytes(dng_bytes(samples))
    assert not [fault for fault in faults(open_session(folder)) if not fault.is_warning]


def test_without_the_library_a_raw_photo_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(SessionError, match=r"pip install 'refractive-scan\[raw\]'"):
        decode_grey(b"", Path("a.cr2"), primary="green")
