"""The layout that the import guide shows describes the folder that it names."""

import re
from pathlib import Path

from recon.sessions.importer import import_folder, read_layout
from recon.sessions.session import open_session

REPOSITORY = Path(__file__).parents[2]
PAGE = (REPOSITORY / "docs/how-to/import-photos.md").read_text(encoding="utf-8")
PHOTOS = REPOSITORY / "tests/data/povray-semi-ellipsoid/smooth"


def toml_blocks() -> list[str]:
    return re.findall(r"^```toml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def test_the_layout_on_the_page_imports_the_folder_that_the_page_names(tmp_path: Path) -> None:
    layout_file = tmp_path / "layout.toml"
    layout_file.write_text(toml_blocks()[0], encoding="utf-8")
    count = import_folder(PHOTOS, tmp_path / "session", read_layout(layout_file))
    # Four sets of two sweeps with 192 photos, and a white and a black photo each.
    assert count == 4 * (2 * 192 + 2)
    assert len(open_session(tmp_path / "session").photos) == count


def test_the_folder_names_on_the_page_replace_those_of_the_sets(tmp_path: Path) -> None:
    layout_file = tmp_path / "layout.toml"
    layout_file.write_text("\n".join(toml_blocks()), encoding="utf-8")
    for set_name, folder in read_layout(layout_file).names.folders.items():
        (tmp_path / "renamed").mkdir(exist_ok=True)
        (tmp_path / "renamed" / folder).symlink_to(PHOTOS / set_name)
    assert import_folder(tmp_path / "renamed", tmp_path / "session", read_layout(layout_file)) == 4 * 386
