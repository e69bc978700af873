"""Render the reference of the two programs from their own help: `make commands`."""

import os
import re
import subprocess
import sys
from pathlib import Path

HEADER = """\
# Commands

<!-- Rendered from the programs' own help by `make commands`; a test compares. Do not edit. -->

Exit status: 0 when it worked, 1 or 2 when it did not; the reason is one sentence on the error output.

"""


def render(program: str) -> str:
    """Return one program's help as Markdown, with headings one level down."""
    command = [sys.executable, "-m", "typer", "--app", "app", f"{program}.cli", "utils", "docs", "--name", program]
    # A fixed width and no colours: the page must not depend on who renders it.
    environment = {**os.environ, "COLUMNS": "100", "NO_COLOR": "1", "TERM": "dumb"}
    text = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    text = re.sub(r"^(#+ )", r"#\1", text, flags=re.MULTILINE)
    return re.sub(r"[ \t]+$", "", text, flags=re.MULTILINE).strip() + "\n"


def page() -> str:
    """Return the whole page."""
    return HEADER + "\n".join(render(program) for program in ("recon", "rig"))


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
