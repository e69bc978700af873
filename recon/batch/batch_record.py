"""What a batch is: its sessions by name and what they are told, kept in ``OUT/batch.json`` for those that go on with it."""

import hashlib
import json
import secrets
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from recon.batch.session_status import SessionStatus, load_status
from recon.errors import ReconError
from recon.metrics import METRICS_NAME, Metrics, load_metrics
from recon.running.input_hashes import input_hashes
from recon.running.settings import Settings
from recon.sessions.disk import Disk, make_folders, write_whole

RECORD_NAME = "batch.json"


class BatchRecord(BaseModel):
    """All that ``batch.json`` holds: sessions by name."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: int = 1
    sessions: dict[str, Path]


def new_batch_id() -> str:
    """Return a name for one call of ``recon batch``, by which a session's status is known to be of it."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{secrets.token_hex(4)}"


@dataclass(frozen=True, slots=True)
class Batch:
    """One call of ``recon batch``; results of the session ``name`` go to ``folder / name``."""

    folder: Path
    sessions: dict[str, Path]
    settings: Settings
    id: str = field(default_factory=new_batch_id)

    @property
    def settings_hash(self) -> str:
        """A hash of all that changes a result: not the number of threads."""
        parts = {**self.settings.result_parts(), "calibration": self.settings.calibration}
        return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:20]

    def waiting(self, name: str) -> SessionStatus:
        """Return the status of a session that this call is to take up."""
        return SessionStatus(
            session=str(self.sessions[name]), state="waiting", batch=self.id, settings=self.settings_hash
        )

    def status_of(self, name: str) -> SessionStatus:
        """Return how far a session is."""
        found = load_status(self.folder / name)
        return found if found is not None and found.session == str(self.sessions[name]) else self.waiting(name)

    def metrics_of(self, name: str) -> Metrics | None:
        """Return the numbers of a session that is done, and None for the others."""
        if self.status_of(name).state != "done":
            return None
        try:
            return load_metrics(self.folder / name / METRICS_NAME)
        except ReconError:
            return None

    def is_done(self, name: str) -> bool:
        """Tell whether a session is done with these settings, from the very manifest and journal that it has today."""
        metrics = self.metrics_of(name)
        if metrics is None or self.status_of(name).settings != self.settings_hash:
            return False
        try:
            return metrics.hashes == input_hashes(self.sessions[name], calibration=self.settings.calibration)
        except OSError:
            return False

    def has_failed(self, name: str) -> bool:
        """Tell whether a session failed with these settings."""
        status = self.status_of(name)
        return status.state == "failed" and status.settings == self.settings_hash


def save_record(batch: Batch) -> None:
    """Make the batch's folder and write ``batch.json``; raises ``ReconError`` where the folder cannot be used."""
    for name, session in batch.sessions.items():
        if session == (batch.folder / name).resolve():
            raise ReconError(
                f"{batch.folder}: the results of {name} would go into the session itself; choose another folder with --out"
            )
    disk = Disk()
    try:
        make_folders(batch.folder, disk=disk)
        text = BatchRecord(sessions=batch.sessions).model_dump_json(indent=1) + "\n"
        write_whole(batch.folder / RECORD_NAME, text.encode(), disk=disk)
    except OSError as error:
        raise ReconError(
            f"{batch.folder}: cannot be written ({error.strerror}); choose another folder with --out"
        ) from error


def recorded_sessions(folder: Path) -> dict[str, Path]:
    """Return the sessions of the batch in ``folder``, by name; raises ``ReconError`` where there is none."""
    path = folder / RECORD_NAME
    try:
        return BatchRecord.model_validate_json(path.read_text(encoding="utf-8")).sessions
    except FileNotFoundError:
        raise ReconError(f"{path}: no such file, so there is no batch to go on with; name its sessions") from None
    except (OSError, UnicodeDecodeError, ValidationError) as error:
        raise ReconError(
            f"{path}: not the record of a batch ({str(error).splitlines()[0]}); name its sessions"
        ) from None
