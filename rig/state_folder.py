"""Where this program keeps what outlives a command: the display's token and certificate, the ledgers of the liquid."""

import os
from pathlib import Path


def state_folder() -> Path:
    """Return the folder, after the XDG base directory specification; it need not exist yet."""
    base = os.environ.get("XDG_STATE_HOME", "")
    return (Path(base) if base else Path.home() / ".local" / "state") / "refractive-scan"
