"""What the rig's thread and the server's thread know together: the frame that should be on the glass, and what the page said.

Frames are numbered by ``seq``, which only ever grows; an acknowledgement counts for the newest frame and no other. ``run``
names this server: a page that lived through a restart may still acknowledge a frame of the server before.
"""

import secrets
import threading
import time
from collections.abc import Callable

from drivers.protocols import Frame
from drivers.stripe_player.wire import PageMessage, PageReport, encode_frame


class Mailbox:
    """Everything here may be called from any thread."""

    def __init__(self) -> None:
        self.run = secrets.token_hex(8)
        self._changed = threading.Condition()
        self._report: PageReport | None = None
        self._seq = 0
        self._acknowledged = 0
        self._message: bytes | None = None

    # The rig's side

    def post(self, frame: Frame, *, columns: int, rows: int, frame_id: int) -> int:
        """Make ``frame`` the one that should be on the glass, and return its number."""
        with self._changed:
            self._seq += 1
            self._message = encode_frame(
                frame, columns=columns, rows=rows, run=self.run, seq=self._seq, frame_id=frame_id
            )
            return self._seq

    def report(self) -> PageReport | None:
        """Return what the page last said of itself, or None while no page is connected."""
        with self._changed:
            return self._report

    def wait_for(self, done: Callable[[], bool], *, deadline_s: float) -> bool:
        """Wait until ``done()``, asked anew whenever the page speaks or goes; False when the deadline came first.

        ``deadline_s`` is a time of :func:`time.monotonic`. ``done`` may raise.
        """
        with self._changed:
            while not done():
                left_s = deadline_s - time.monotonic()
                if left_s <= 0:
                    return False
                self._changed.wait(left_s)
            return True

    def is_acknowledged(self, seq: int) -> bool:
        """Return whether the page has shown frame ``seq``, and it is still the newest."""
        with self._changed:
            return seq == self._seq == self._acknowledged

    # The server's side

    def message(self) -> bytes | None:
        """Return the message of the frame that should be on the glass."""
        with self._changed:
            return self._message

    def take(self, message: PageMessage) -> None:
        """Take what the page said; an acknowledgement of any but the newest frame is only a report."""
        with self._changed:
            self._report = message.report
            if message.kind == "ack" and message.run == self.run and message.seq == self._seq:
                self._acknowledged = message.seq
            self._changed.notify_all()

    def page_is_gone(self) -> None:
        """Note that no page is connected."""
        with self._changed:
            self._report = None
            self._changed.notify_all()
