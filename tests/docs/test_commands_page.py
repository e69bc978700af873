"""The reference of the commands is what the programs say of themselves."""

import importlib.util
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
RENDERER = REPOSITORY / "docs/render_commands.py"


def test_the_commands_page_is_current_or_make_commands_renders_it_again() -> None:
    spec = importlib.util.spec_from_file_location("render_commands", RENDERER)
    assert spec is not None
    assert spec.loader is not None
    renderer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(renderer)
    kept = (REPOSITORY / "docs/reference/commands.md").read_text(encoding="utf-8")
    assert kept == renderer.page(), "docs/reference/commands.md is out of date; run: make commands"
