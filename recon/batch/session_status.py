"""How far a session of a batch is: ``OUT/NAME/status.json``, always whole, and true whatever was killed."""

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from recon.sessions.disk import Disk, make_folders, write_whole

STATUS_NAME = "status.json"
State = Literal["waiting", "running", "done", "failed", "stopped"]
# A session that lost two workers is likely to be what kills them.
MOST_ATTEMPTS = 2


class Attempt(BaseModel):
    """One worker that took a session up. ``end`` is empty while it works; times are UTC, ISO 8601."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    host: str
    process: int
    began: str
    end: Literal["", "done", "failed", "lost", "stopped"] = ""
    cause: str = ""  # of a loss, where it is known: killed by SIGKILL

    @property
    def worker(self) -> str:
        """The worker as a person may look for it."""
        return f"process {self.process} on {self.host}"


class SessionStatus(BaseModel):
    """All that ``status.json`` holds. ``batch`` names the call of ``recon batch``, ``settings`` is their hash."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: Literal[1] = 1
    session: str
    state: State
    batch: str
    settings: str
    fault: str = ""
    attempts: tuple[Attempt, ...] = ()

    def begun(self, attempt: Attempt) -> "SessionStatus":
        """Return the status with one more worker at work."""
        return self.model_copy(update={"state": "running", "fault": "", "attempts": (*self.attempts, attempt)})

    def ended(self, state: Literal["done", "failed", "stopped"], *, fault: str = "") -> "SessionStatus":
        """Return the status after its last worker came to an end."""
        return self._closed(state, cause="").model_copy(update={"state": state, "fault": fault})

    def lost(self, cause: str = "") -> "SessionStatus":
        """Return the status of a session whose worker is gone: it waits again, or failed where that was the last attempt."""
        closed = self._closed("lost", cause=cause)
        if len(closed.attempts) < MOST_ATTEMPTS:
            return closed.model_copy(update={"state": "waiting"})
        return closed.model_copy(update={"state": "failed", "fault": f"{closed.losses()}; it was not tried again"})

    def losses(self) -> str:
        """Name the workers that were lost with this session, or say nothing."""
        lost = [one.worker + (f" ({one.cause})" if one.cause else "") for one in self.attempts if one.end == "lost"]
        return f"lost its worker: {', then '.join(lost)}" if lost else ""

    def _closed(self, end: Literal["done", "failed", "lost", "stopped"], *, cause: str) -> "SessionStatus":
        if not self.attempts:
            return self
        last = self.attempts[-1].model_copy(update={"end": end, "cause": cause})
        return self.model_copy(update={"attempts": (*self.attempts[:-1], last)})


def save_status(status: SessionStatus, folder: Path) -> None:
    """Write ``status.json`` into a session's folder of results, which is made; raises ``OSError``."""
    disk = Disk()
    make_folders(folder, disk=disk)
    write_whole(folder / STATUS_NAME, status.model_dump_json(indent=1).encode() + b"\n", disk=disk)


def load_status(folder: Path) -> SessionStatus | None:
    """Read ``status.json``; None where there is none that can be read."""
    try:
        return SessionStatus.model_validate_json((folder / STATUS_NAME).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ValidationError):
        return None
