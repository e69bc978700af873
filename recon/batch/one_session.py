"""One session of a batch, wherever a worker takes it up: nothing that is wrong with it leaves this module but as its status."""

import contextlib
import io
import os
import socket
import threading
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import cv2

from recon.batch.cores import place, usable_cores
from recon.batch.session_status import Attempt, SessionStatus, load_status, save_status
from recon.errors import ReconError, sentence
from recon.program import program_hash
from recon.running.settings import Settings

STOP_NAME = "stop"
MESSAGES_NAME = "messages.txt"
# A worker of several threads would share its memory, its streams and OpenCV's settings between sessions.
_ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True, slots=True)
class SessionTask:
    """What a worker is told. ``workers_at`` counts the workers of each place, which share its cores."""

    name: str
    session: Path
    batch_folder: Path
    settings: Settings
    waiting: SessionStatus
    program: str
    workers_at: Mapping[str, int] = field(default_factory=dict)

    @property
    def out(self) -> Path:
        """The folder of this session's results."""
        return self.batch_folder / self.name


def run_one(task: SessionTask) -> SessionStatus:
    """Reconstruct one session and return its status; raises only where ``status.json`` cannot be written.

    A task that comes a second time was lost with its worker, or its answer was: what ended is not done again.
    """
    with _ONE_AT_A_TIME:
        status = load_status(task.out)
        if status is None or status.batch != task.waiting.batch:
            status = task.waiting
        if status.state in ("done", "failed", "stopped") or (task.batch_folder / STOP_NAME).exists():
            return status
        if status.state == "running":
            status = status.lost()
            save_status(status, task.out)
            if status.state == "failed":
                return status
        began = datetime.now(UTC).isoformat(timespec="seconds")
        status = status.begun(Attempt(host=socket.gethostname(), process=os.getpid(), began=began))
        save_status(status, task.out)
        fault = _fault_of(task)
        status = status.ended("failed" if fault else "done", fault=fault)
        save_status(status, task.out)
        return status


def _fault_of(task: SessionTask) -> str:
    """Reconstruct; return an empty string, or the sentence that says why it could not be done."""
    from recon.run import run_session  # loads the report's plotting, which the coordinator never needs

    messages = io.StringIO()
    try:
        if task.program != program_hash():
            raise ReconError(
                f"recon on {socket.gethostname()} is not the one that this batch was begun with, or was changed since; "
                "install the same everywhere, and begin the batch again"
            )
        threads = task.settings.threads or max(usable_cores() // task.workers_at.get(place(), 1), 1)
        cv2.setNumThreads(threads)
        # Several sessions would draw their bars over each other.
        with contextlib.redirect_stderr(messages):
            run_session(task.session, task.out, replace(task.settings, threads=threads))
        return ""
    except (ReconError, MemoryError, OSError) as error:
        return sentence(error)
    except Exception as error:  # a fault of ours in one session must not take the others with it
        messages.write(traceback.format_exc())
        return f"unexpected fault ({type(error).__name__}: {error}); please report it with {task.out / MESSAGES_NAME}"
    finally:
        if messages.getvalue():
            with contextlib.suppress(OSError):  # the fault itself is in the status
                (task.out / MESSAGES_NAME).write_text(messages.getvalue(), encoding="utf-8")
