"""Decodes each sweep while the next is photographed: our side of the process ``recon.sweeps.decode_service``.

Nothing here waits unless it is asked to, and nothing that happens to that process harms the capture: at worst there are no
verdicts.
"""

import contextlib
import json
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

POLL_S = 0.2


class LiveDecoder:
    """One process for one session. ``failure`` is a sentence once the process is lost, empty before."""

    def __init__(self, folder: Path) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "recon.sweeps.decode_service", str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,  # Ctrl-C is for the capture, which ends this process in its own time
        )
        self._answers: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._reader = threading.Thread(target=self._read, name="live decoder", daemon=True)
        self._reader.start()
        self._waiting = 0
        self.failure = ""

    @property
    def process_id(self) -> int:
        """The number of the process, for those who watch it."""
        return self._process.pid

    @property
    def busy(self) -> bool:
        """Whether an answer is still to come."""
        return self._waiting > 0 and not self.failure

    def ask(self, question: dict[str, Any]) -> None:
        """Ask for one thing (see ``recon.sweeps.decode_service``); it is answered in its turn."""
        if self.failure:
            return
        assert self._process.stdin is not None  # opened as a pipe
        try:
            self._process.stdin.write(json.dumps(question) + "\n")
            self._process.stdin.flush()
            self._waiting += 1
        except OSError:
            self._lose()

    def answers(self) -> list[dict[str, Any]]:
        """Return the answers that have come since the last call, without waiting."""
        found = []
        with contextlib.suppress(queue.Empty):
            while True:
                answer = self._answers.get_nowait()
                if answer is None:
                    self._lose()
                    break
                self._waiting -= 1
                found.append(answer)
        return found

    def wait(self, *, timeout_s: float, on_poll: Callable[[], None]) -> list[dict[str, Any]]:
        """Return every answer that is due, waiting for it; ``on_poll`` is called now and then and may raise."""
        end_s = time.monotonic() + timeout_s
        found = self.answers()
        while self.busy and time.monotonic() < end_s:
            on_poll()
            time.sleep(POLL_S)
            found += self.answers()
        if self.busy:
            self._waiting = 0
            self.failure = (
                f"live decoding took longer than {timeout_s:.0f} s and is left alone; the capture goes on without it"
            )
        return found

    def _read(self) -> None:
        assert self._process.stdout is not None  # opened as a pipe
        for line in self._process.stdout:
            try:
                self._answers.put(json.loads(line))
            except ValueError:
                break
        self._answers.put(None)

    def _lose(self) -> None:
        if not self.failure:
            code = self._process.poll()
            ended = "" if code is None else f" (exit code {code})"
            self.failure = f"the process that decodes sweeps ended{ended}; the capture goes on without verdicts"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
