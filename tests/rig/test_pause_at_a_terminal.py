"""A person at a real terminal: Ctrl-C pauses, a letter says how to go on."""

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from recon.sessions.session import open_session

# Generous, because continuous integration may be slow; nothing waits that long when all is well.
PATIENCE_S = 60.0


class Terminal:
    """What a program printed on its terminal, and a keyboard."""

    def __init__(self, process: subprocess.Popen[bytes], keyboard: int) -> None:
        self.process = process
        self._keyboard = keyboard
        self.text = ""

    def wait_for(self, words: str) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while words not in self.text:
            assert time.monotonic() < deadline_s, self.text
            if select.select([self._keyboard], [], [], 0.1)[0]:
                try:
                    self.text += os.read(self._keyboard, 65536).decode(errors="replace")
                except OSError:  # the program ended and took its side of the terminal with it
                    assert words in self.text, self.text

    def press_ctrl_c(self) -> None:
        self.process.send_signal(signal.SIGINT)

    def type(self, line: str) -> None:
        self.text = ""
        os.write(self._keyboard, line.encode() + b"\n")


@contextmanager
def terminal(*arguments: str, folder: Path) -> Iterator[Terminal]:
    keyboard, screen = os.openpty()
    command = [sys.executable, "-c", "from rig.cli import main; main()", *arguments]
    environment = {**os.environ, "COLUMNS": "200", "TERM": "xterm"}
    process = subprocess.Popen(command, cwd=folder, stdin=screen, stdout=screen, stderr=screen, env=environment)
    os.close(screen)
    try:
        yield Terminal(process, keyboard)
    finally:
        process.kill()
        process.wait()
        os.close(keyboard)


def test_ctrl_c_pauses_and_letters_say_how_to_go_on(tmp_path: Path) -> None:
    small = ("--size", "32", "--display-columns", "32", "--step-px", "4")
    with terminal("capture", "--sim", "--real-time", "--session", "s", *small, folder=tmp_path) as screen:
        screen.wait_for("photo pos0_air")
        screen.press_ctrl_c()
        screen.wait_for("pausing after this photo; press Ctrl-C again to stop at once")
        screen.wait_for("q: stop here and resume later")
        assert "of 72 photos; pump and stage stand still, the tank holds 0 ml" in screen.text
        screen.type("what?")
        screen.wait_for("'what?' is none of these letters.")
        screen.wait_for("q: stop here and resume later")
        screen.type("p")
        screen.wait_for("q: stop here and resume later")
        screen.type("q")
        screen.wait_for("go on with `rig capture --resume --session s --sim`")
        assert screen.process.wait(PATIENCE_S) == 130
    assert 2 <= len(open_session(tmp_path / "s").photos) <= 4
