"""Chromium without a window, driven through two pipes.

It speaks the Chrome DevTools Protocol, each message ended by a zero byte, on its file descriptors 3 (in) and 4 (out):
``--remote-debugging-pipe``. No port is opened, and it ends by itself when the pipes close.
"""

import fcntl
import itertools
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Any

from drivers.errors import DeviceError, DeviceNotFoundError, DeviceTimeoutError

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = (
    "--headless=new",
    "--remote-debugging-pipe",
    "--disable-gpu",
    "--disable-dev-shm-usage",  # containers have little of it
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--force-color-profile=srgb",
)
ANSWER_TIMEOUT_S = 60.0
END_TIMEOUT_S = 10.0
# Above the descriptors that Chromium wants, so that moving one there does not close the other.
LOWEST_FREE_DESCRIPTOR = 10
# Runs in the new process: puts the pipes where Chromium wants them, and becomes Chromium.
LAUNCHER = (
    "import os, sys; heard, said = int(sys.argv[1]), int(sys.argv[2]); os.dup2(heard, 3); os.dup2(said, 4); "
    "os.close(heard); os.close(said); os.execv(sys.argv[3], sys.argv[3:])"
)


class Chromium:
    """A running Chromium, from entering to leaving the context. Calls block; what it says unasked is dropped."""

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._unread = b""

    def __enter__(self) -> "Chromium":
        program = next((path for name in PROGRAMS if (path := shutil.which(name))), None)
        if program is None:
            raise DeviceNotFoundError(
                "tablet: Chromium, which plays the tablet, is not installed; on Debian: apt-get install chromium"
            )
        self._folder = tempfile.TemporaryDirectory(prefix="tablet-", ignore_cleanup_errors=True)
        heard, self._to = _pipe()
        self._from, said = _pipe()
        # Root has no sandbox to give; Chromium then refuses to start with one.
        options = (*OPTIONS, "--no-sandbox") if os.geteuid() == 0 else OPTIONS
        command = [program, *options, f"--user-data-dir={Path(self._folder.name)}", "about:blank"]
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", LAUNCHER, str(heard), str(said), *command],
            pass_fds=(heard, said),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # a Ctrl-C that stops the capture must not end the tablet in mid-photo
        )
        os.close(heard)
        os.close(said)
        try:
            self.call("Browser.getVersion")
        except DeviceError:
            self.__exit__(None, None, None)
            raise DeviceNotFoundError(
                f"tablet: {program}, which plays the tablet, does not start; `{program} --headless=new --dump-dom "
                "about:blank` tells why"
            ) from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._to)
        os.close(self._from)
        try:
            self._process.wait(END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()

    def call(self, method: str, *, session: str = "", **parameters: object) -> dict[str, Any]:
        """Call a method of the protocol and return its result; any thread may, one at a time.

        Raises
        ------
        DeviceTimeoutError
            When Chromium does not answer.
        DeviceError
            When it refuses, or has ended.
        """
        with self._lock:
            number = next(self._numbers)
            message = {"id": number, "method": method, "params": parameters}
            if session:
                message["sessionId"] = session
            self._send(json.dumps(message).encode() + b"\0")
            deadline_s = time.monotonic() + ANSWER_TIMEOUT_S
            while True:
                answer = json.loads(self._message(method, deadline_s))
                if answer.get("id") == number:
                    break
        if "error" in answer:
            raise DeviceError(f"tablet: Chromium refuses {method}: {answer['error'].get('message', '')}")
        result: dict[str, Any] = answer["result"]
        return result

    def _send(self, data: bytes) -> None:
        try:
            while data:
                data = data[os.write(self._to, data) :]
        except OSError:
            raise DeviceError("tablet: Chromium has ended; resume the capture") from None

    def _message(self, method: str, deadline_s: float) -> bytes:
        while b"\0" not in self._unread:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0 or not select.select([self._from], [], [], left_s)[0]:
                raise DeviceTimeoutError(f"tablet: Chromium did not answer {method} within {ANSWER_TIMEOUT_S:g} s")
            data = os.read(self._from, 1 << 20)
            if not data:
                raise DeviceError("tablet: Chromium has ended; resume the capture")
            self._unread += data
        message, _, self._unread = self._unread.partition(b"\0")
        return message


def _pipe() -> tuple[int, int]:
    """Return the reading and the writing end of a pipe."""
    low = os.pipe()
    ends = [fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, LOWEST_FREE_DESCRIPTOR) for end in low]
    for end in low:
        os.close(end)
    return ends[0], ends[1]
