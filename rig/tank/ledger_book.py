"""Where a ledger is kept: a file of its events for a rig that lasts, memory for a rehearsal that does not."""

import re
from pathlib import Path

from recon.errors import SessionError
from recon.sessions.disk import Disk, make_folders
from recon.sessions.journal import JournalWriter, now_text, read_journal
from rig.config import RigConfig
from rig.errors import LedgerError
from rig.state_folder import state_folder
from rig.tank.ledger import Event, Ledger, after, entry_of, event_of, new_ledger


class LedgerBook:
    """The ledger of one rig. With a ``path`` every event is on the disk before :meth:`note` returns.

    Raises
    ------
    LedgerError
        When the file is damaged.
    """

    def __init__(self, path: Path | None, *, total_ml: float) -> None:
        self._path = path
        self.ledger: Ledger = new_ledger(total_ml=total_ml)
        if path is not None and path.exists():
            self._read(path)

    def _read(self, path: Path) -> None:
        try:
            for entry in read_journal(path):
                self.ledger = after(self.ledger, event_of(entry), when=entry["time"])
        except (LedgerError, SessionError) as error:
            raise LedgerError(
                f"{path}: what is known of the liquid cannot be read ({error}); look at tank and reservoir, move this file "
                "away, and say what they hold with `rig pump level`"
            ) from None

    def note(self, event: Event) -> None:
        """Take down what is about to happen, or has happened."""
        name, fields = entry_of(event)
        if self._path is not None:
            disk = Disk()
            make_folders(self._path.parent, disk=disk)
            with JournalWriter(self._path, disk=disk) as writer:
                writer.append(name, **fields)
            disk.flush_folder(self._path.parent)
        self.ledger = after(self.ledger, event, when=now_text())


def book_of(config: RigConfig, path: Path | None) -> LedgerBook:
    """Open the ledger of the rig that ``config`` describes: its liquid is what the configuration says is in the reservoir."""
    return LedgerBook(path, total_ml=config.tank.reservoir_ml if config.tank else 0.0)


def real_book(config: RigConfig) -> LedgerBook:
    """Open the ledger of the real rig that ``config`` describes, in the program's own folder."""
    return book_of(config, book_file(state_folder(), config.devices.pump))


def book_file(folder: Path, pump_address: str) -> Path | None:
    """Return the file for the rig whose pump answers at ``pump_address``; None where a person pours, who is asked."""
    name = re.sub(r"[^A-Za-z0-9]+", "-", pump_address).strip("-")
    return folder / "liquid" / f"{name}.jsonl" if name else None
