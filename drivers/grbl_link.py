"""Questions and answers with a GRBL controller, and an ear for what it says unasked: banners, alarms, messages."""

import logging
import re

from drivers.errors import DeviceAlarmError, DeviceProtocolError, DeviceTimeoutError
from drivers.grbl_protocol import (
    ALARMS,
    SOFT_RESET,
    STATUS,
    GrblStatus,
    is_banner,
    read_code,
    read_status,
    reason_of,
)
from drivers.serial_port import SerialPort, deadline_after

# GRBL answers within a few milliseconds; while it writes its EEPROM it may take some hundred.
ANSWER_S = 2.0
STATUS_S = 0.5
STATUS_TRIES = 4
# After these GRBL ignores everything, even "?", until it is reset.
DEAD_AFTER = (1, 2)

log = logging.getLogger(__name__)


class GrblRefusal(DeviceProtocolError):
    """A line was answered with ``error:N``."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class GrblLink:
    """The conversation on one port. ``alarm`` and ``has_restarted`` tell what came unasked since :meth:`forget`."""

    def __init__(self, port: SerialPort) -> None:
        self._port = port
        self.alarm: int | None = None
        self.has_restarted = False
        self.has_lost_settings = False

    def forget(self) -> None:
        """Begin anew: what was heard so far has been dealt with."""
        self.alarm = None
        self.has_restarted = False

    def listen(self) -> str | None:
        """Return one line that has come, or None; banners and alarms are noted on the way."""
        line = self._port.read_if_there(b"\n")
        return None if line is None else self._understand(line)

    def catch_up(self) -> None:
        """Note everything that came unasked; an answer among it comes too late and is dropped."""
        while (text := self.listen()) is not None:
            if text:
                log.debug("%s: unasked: %s", self._port.device, text)

    def hears_banner_within(self, timeout_s: float) -> bool:
        """Wait for the greeting of a controller that has just started."""
        deadline_s = deadline_after(timeout_s)
        try:
            while not self.has_restarted:
                self._understand(self._port.read_until(b"\n", deadline_s=deadline_s))
        except DeviceTimeoutError:
            return False
        return True

    def send(self, data: bytes) -> None:
        """Send realtime bytes or a line whose answer is awaited elsewhere."""
        self._port.write(data)

    def command(self, line: str) -> list[str]:
        """Send ``line`` and return what it printed before its ``ok``.

        Raises
        ------
        GrblRefusal
            When it is answered with ``error:N``.
        DeviceAlarmError
            When the controller stops with an alarm instead.
        DeviceTimeoutError
            When no answer comes.
        """
        with self._port.transaction():
            self.catch_up()
            self._port.write(line.encode("ascii") + b"\n")
            deadline_s = deadline_after(ANSWER_S)
            printed: list[str] = []
            while True:
                raw = self._port.read_until(b"\n", deadline_s=deadline_s, question=f"the answer to {line!r}")
                text = self._understand(raw)
                if text == "ok":
                    return printed
                if (code := read_code(text, word="error")) is not None:
                    refusal = f"{self._port.device}: {line!r} was refused with error:{code}: {reason_of(code)}"
                    raise GrblRefusal(refusal, code)
                if self.alarm in DEAD_AFTER:
                    raise self.alarm_error()
                printed.append(text)

    def ask(self, line: str) -> list[str]:
        """As :meth:`command`, for questions that may be repeated: tries again when noise swallowed the answer."""
        try:
            return self.command(line)
        except DeviceTimeoutError:
            self._port.resynchronise(quiet_s=0.1, deadline_s=deadline_after(1.0))
            return self.command(line)

    def status(self) -> GrblStatus:
        """Ask for a status report; repeated a few times, since a realtime byte is neither queued nor acknowledged."""
        with self._port.transaction():
            self.catch_up()
            for _ in range(STATUS_TRIES):
                if self.alarm in DEAD_AFTER:
                    raise self.alarm_error()
                self._port.write(STATUS)
                try:
                    return self._next_report()
                except DeviceTimeoutError as error:
                    silence = error
            raise silence

    def _next_report(self) -> GrblStatus:
        deadline_s = deadline_after(STATUS_S)
        while True:
            text = self._understand(self._port.read_until(b"\n", deadline_s=deadline_s, question="a status report"))
            report = read_status(text)
            if report is not None:
                return report
            if self.alarm in DEAD_AFTER:
                raise self.alarm_error()

    def reset(self) -> None:
        """Soft reset: everything stops at once, and a machine that moved no longer knows where it is."""
        with self._port.transaction():
            self.forget()
            self._port.write(SOFT_RESET)
            if not self.hears_banner_within(ANSWER_S):
                raise DeviceTimeoutError(
                    f"{self._port.device}: no GRBL answers on {self._port.address}, not even to a reset; check that it "
                    "is switched on, that this is the right port, and that it speaks 115200 baud"
                )
            self._port.resynchronise(quiet_s=0.05, deadline_s=deadline_after(1.0))
            self.forget()

    def alarm_error(self) -> DeviceAlarmError:
        """Return the sentence for the alarm that was noted."""
        reason = ALARMS.get(self.alarm or 0, "see alarm_codes_en_US.csv of GRBL, then home the stage")
        return DeviceAlarmError(f"{self._port.device}: the controller stopped with ALARM:{self.alarm}: {reason}")

    def _understand(self, line: bytes) -> str:
        """Return the printable part of a line, and note what it says of the controller."""
        text = re.sub(r"[^ -~]", "", line.decode("ascii", errors="ignore")).strip()
        alarm = read_code(text, word="ALARM")
        if alarm is not None:
            self.alarm = alarm
        elif is_banner(text):
            self.has_restarted = True
        elif text == "error:7":
            self.has_lost_settings = True
        return text
