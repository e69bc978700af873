"""The state machine of an emulated tank board, as the page on building one describes it (``build-a-pump-board``)."""

import re
from dataclasses import dataclass

HEARTBEAT_MS = 1000
LONGEST_RUN_MS = 1_800_000
DEBOUNCE_MS = 20
IDENTITY = "tank-board/1"
LINE = re.compile(r"([^ ]{1,7})(?: ([0-9]{1,9}))?", re.ASCII)
QUESTIONS = ("STATE?", "LEVEL?", "LEAK?")


@dataclass(frozen=True, slots=True)
class Inputs:
    """The two normally closed contacts and the level sensor's counts."""

    leak_open: bool
    full_open: bool
    level: int


class Contact:
    """Counts as open once it was seen open for ``DEBOUNCE_MS``."""

    def __init__(self) -> None:
        self.open = False
        self.since_ms: int | None = None

    def sample(self, is_open: bool, now_ms: int) -> None:
        """Look at the contact."""
        if not is_open:
            self.open, self.since_ms = False, None
            return
        if self.since_ms is None:
            self.since_ms = now_ms
        self.open = self.open or now_ms - self.since_ms >= DEBOUNCE_MS


class TankBoardLogic:
    """States and replies of the board; ``tick`` comes before every ``command`` with the same time.

    ``heartbeat_ms`` is how long a host may be silent while the pump runs.
    """

    def __init__(self, *, heartbeat_ms: int = HEARTBEAT_MS) -> None:
        self._heartbeat_ms = heartbeat_ms
        self.state = "IDLE"
        self.fault = "reset"
        self._leak, self._full = Contact(), Contact()
        self._level = 0
        self._started_ms = self._heard_ms = self._run_ms = self._ran_ms = 0

    def next_event_ms(self) -> int | None:
        """Return when the board will stop by itself if nobody says anything."""
        if self.state == "IDLE":
            return None
        return min(self._started_ms + self._run_ms, self._heard_ms + self._heartbeat_ms)

    def tick(self, now_ms: int, inputs: Inputs) -> None:
        """Bring the board to ``now_ms``."""
        self._leak.sample(inputs.leak_open, now_ms)
        self._full.sample(inputs.full_open, now_ms)
        self._level = inputs.level
        if self.state != "IDLE":
            self._ran_ms = now_ms - self._started_ms
            if self._ran_ms >= self._run_ms:
                self.state = "IDLE"
            elif now_ms - self._heard_ms >= self._heartbeat_ms:
                self.state, self.fault = "IDLE", "heartbeat"
            elif self.state == "FILLING" and self._full.open:
                self.state, self.fault = "IDLE", "full"
        if self._leak.open:
            self.state, self.fault = "IDLE", "leak"

    def command(self, line: str, now_ms: int) -> str:
        """Carry out one line and return the reply."""
        match = LINE.fullmatch(line)
        verb, time_text = match.groups() if match else ("?", None)
        if verb in ("FILL", "DRAIN"):
            why = self._refusal(verb, int(time_text or 0))
            if not why:
                self._start(verb, int(time_text or 0), now_ms)
            return self.reply(verb, why)
        if time_text is None and verb == "HB":
            self._heard_ms = now_ms
        elif time_text is None and verb == "STOP":
            self.state = "IDLE"
            reply = self.reply(verb)  # names the fault that this STOP acknowledges
            self.fault = "leak" if self._leak.open else "none"
            return reply
        elif time_text is None and verb == "ID?":
            return f"{self.reply(verb)} id={IDENTITY}"
        elif verb not in QUESTIONS or time_text is not None:
            return self.reply("?", "unknown")
        return self.reply(verb)

    def _refusal(self, verb: str, time_ms: int) -> str:
        if not 0 < time_ms <= LONGEST_RUN_MS:
            return "time"
        if self.state != "IDLE":
            return "busy"
        if self._leak.open:
            return "leak"
        if verb == "FILL" and self._full.open:
            return "full"
        return "fault" if self.fault != "none" else ""

    def _start(self, verb: str, time_ms: int, now_ms: int) -> None:
        self.state = verb + "ING"
        self._run_ms, self._ran_ms = time_ms, 0
        self._started_ms = self._heard_ms = now_ms

    def reply(self, verb: str, why: str = "") -> str:
        """Return the line that answers ``verb``; ``why`` makes it a refusal."""
        left_ms = 0 if self.state == "IDLE" else self._run_ms - self._ran_ms
        return (
            f"{'NO' if why else 'OK'} {verb} {self.state} ran={self._ran_ms} left={left_ms} fault={self.fault} "
            f"leak={int(self._leak.open)} full={int(self._full.open)} level={self._level}"
            + (f" why={why}" if why else "")
        )
