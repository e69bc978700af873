"""The driver's side of the process that libgphoto2 lives in (:mod:`drivers.camera_worker`): every call has a deadline."""

import contextlib
import os
import shutil
import site
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

# Beyond its limit a call may take this long before its process counts as wedged and is ended.
GRACE_S = 5.0
# Python, libgphoto2 and its list of cameras: under a second, more on a busy machine or a slow disk.
START_S = 20.0
# A camera that is simulated by libgphoto2 itself must never be taken for a real one.
NEVER_INHERITED = ("VCAMERADIR", "IOLIBS", "CAMLIBS")


class CameraFault(Exception):
    """A call failed. ``code`` is libgphoto2's number, where it gave one."""

    def __init__(self, sentence: str, *, code: int | None = None) -> None:
        super().__init__(sentence)
        self.code = code


class WedgedFault(CameraFault):
    """The process did not answer and was ended, or it ended by itself."""


class LateFault(CameraFault):
    """The call ran out of time in an orderly way; the camera still answers."""


class RefusedFault(CameraFault):
    """The camera cannot do what was asked; trying again will not help."""


@dataclass(frozen=True, slots=True)
class Question:
    """One that was asked: its number, how long its answer may take, and until when (:func:`time.monotonic`)."""

    number: int
    wait_s: float
    end_s: float


class CameraProcess:
    """One process, one camera. ``environment`` adds to its environment variables."""

    def __init__(self, *, environment: Mapping[str, str] | None = None) -> None:
        # libgphoto2 keeps a capture target for all programs of a user; a private folder keeps ours apart.
        self._settings_folder = tempfile.mkdtemp(prefix="camera-")
        self._last_words = tempfile.TemporaryFile()  # noqa: SIM115  (lives as long as the process)
        ours, theirs = socket.socketpair()
        inherited = {name: value for name, value in os.environ.items() if name not in NEVER_INHERITED}
        private = {"XDG_CONFIG_HOME": self._settings_folder, "HOME": self._settings_folder, "LC_ALL": "C"}
        private["PYTHONUSERBASE"] = site.getuserbase()  # where a library installed for one user is found
        self._process = subprocess.Popen(
            [sys.executable, "-m", "drivers.camera_worker", str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stderr=self._last_words,
            env={**inherited, **private, **(environment or {})},
            start_new_session=True,  # Ctrl-C is for the program that owns the camera; it decides what follows
        )
        theirs.close()
        self._pipe = Connection(ours.detach())
        self._fresh = True
        self._questions = 0
        self._last_answer: tuple[Any, ...] = (0,)

    @property
    def alive(self) -> bool:
        """Whether the process can still be asked."""
        return self._process.poll() is None and not self._pipe.closed

    def call(self, operation: str, *, limit_s: float, **arguments: Any) -> Any:
        """Ask for one operation and wait for its answer.

        Raises
        ------
        CameraFault
            Of the kind that says what to do about it. After a :class:`WedgedFault` the process is gone.
        """
        return self.answer(self.ask(operation, limit_s=limit_s, **arguments))

    def ask(self, operation: str, *, limit_s: float, **arguments: Any) -> Question:
        """Ask for one operation that takes at most ``limit_s``; only the answer to the last question is kept."""
        limit_s = max(limit_s, 0.0)
        wait_s = limit_s + GRACE_S + (START_S if self._fresh else 0.0)
        self._questions += 1
        try:
            self._pipe.send((self._questions, operation, arguments, limit_s))
        except OSError as error:
            raise self._ended() from error
        return Question(self._questions, wait_s, time.monotonic() + wait_s)

    def wait(self, question: Question, *, within_s: float) -> bool:
        """Wait for an answer; False when there is none yet. True as well when none can come: :meth:`answer` says why."""
        end_s = min(time.monotonic() + within_s, question.end_s)
        try:
            return self._receive(question, end_s) or time.monotonic() >= question.end_s
        except (EOFError, OSError):
            return True

    def answer(self, question: Question) -> Any:
        """Wait for an answer and return it; raises as :meth:`call` does."""
        try:
            arrived = self._receive(question, question.end_s)
        except (EOFError, OSError) as error:
            raise self._ended() from error
        if not arrived:
            self.end()
            raise WedgedFault(f"no answer within {question.wait_s:.0f} s")
        self._fresh = False
        _number, kind, *answer = self._last_answer
        if kind == "done":
            return answer[0]
        if kind == "gphoto2":
            raise CameraFault(answer[1], code=answer[0])
        raise (LateFault if kind == "late" else RefusedFault)(answer[0])

    def _receive(self, question: Question, end_s: float) -> bool:
        """Receive answers until that of ``question`` is there: that of an interrupted one may come before it."""
        while self._last_answer[0] != question.number:
            if not self._pipe.poll(max(0.0, end_s - time.monotonic())):
                return False
            self._last_answer = self._pipe.recv()
        return True

    def _ended(self) -> WedgedFault:
        """Return what to say of a process that is gone."""
        sentence = self._how_it_ended()
        self.end()
        return WedgedFault(sentence)

    def _how_it_ended(self) -> str:
        """Return the last line that the process wrote, which is what Python says before it ends."""
        if self._pipe.closed:
            return "the process that speaks to it was ended"
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(1.0)
        self._last_words.seek(0)
        lines = self._last_words.read().decode(errors="replace").strip().splitlines()
        return f"the process that speaks to it ended ({lines[-1] if lines else 'without a word'})"

    def end(self) -> None:
        """End the process, whatever it is doing."""
        self._pipe.close()
        self._process.kill()
        self._process.wait()
        self._last_words.close()
        shutil.rmtree(self._settings_folder, ignore_errors=True)
