"""Questions to a New Era pump and their answers, in either mode, past noise and alarms."""

import logging

from drivers.errors import DeviceAlarmError, DeviceProtocolError, DeviceTimeoutError, OutOfVolumeError
from drivers.new_era_wire import ALARMS, ETX, SAFE_EXTRA, STX, Reply, basic_packet, crc, parse_reply, safe_packet
from drivers.serial_port import SerialPort, deadline_after

# Every command but RUN may be repeated: saying it twice leaves the pump as saying it once.
ATTEMPTS = 3
# An alarm swallows the command that it answers; more alarms than this in a row come from a fault that stays.
ALARMS_IN_A_ROW = 4
QUIET_S = 0.05
LONGEST_REPLY = 80

log = logging.getLogger(__name__)


class NewEraLink:
    """The conversation with pump ``pump_number`` on ``port``; in Basic mode until told otherwise.

    ``alarms_acknowledged`` counts the alarms that :meth:`acknowledged` met, ``last_alarm`` is the letter of the last one: the
    pump forgets an alarm that it has told.
    """

    def __init__(self, port: SerialPort, *, pump_number: int, reply_timeout_s: float) -> None:
        self._port = port
        self._pump_number = pump_number
        self._reply_timeout_s = reply_timeout_s
        self.safe = False
        self.alarms_acknowledged = 0
        self.last_alarm = ""

    def exchange(self, command: str, *, attempts: int = ATTEMPTS) -> Reply:
        """Send ``command`` and return the reply, alarm or not; noise and silence are answered by asking again.

        Raises
        ------
        DeviceTimeoutError, DeviceProtocolError
            When the last attempt met silence or noise.
        """
        return self._exchange(command, safe=self.safe, attempts=attempts)

    def _exchange(self, command: str, *, safe: bool, attempts: int) -> Reply:
        text = f"{self._pump_number}{command}"
        packet = safe_packet(text) if safe else basic_packet(text)
        with self._port.transaction():
            for attempt in range(1, attempts + 1):
                self._port.flush_input()
                self._port.write(packet)
                try:
                    reply = self._read(f"the answer to {command or 'a status question'}")
                except (DeviceTimeoutError, DeviceProtocolError) as error:
                    if attempt == attempts:
                        raise
                    log.info("%s; asking again", error)
                    self._port.resynchronise(quiet_s=QUIET_S, deadline_s=deadline_after(self._reply_timeout_s))
                    continue
                if reply.alarm:
                    # Safe mode also announces an alarm of its own accord; the reply to the command may be under way.
                    self._port.resynchronise(quiet_s=QUIET_S, deadline_s=deadline_after(self._reply_timeout_s))
                if reply.data not in ("?COM", "?IGN") or attempt == attempts:
                    return reply
        raise AssertionError("unreachable: the last attempt returns or raises")

    def _read(self, question: str) -> Reply:
        deadline_s = deadline_after(self._reply_timeout_s)
        while True:
            self._port.read_until(STX, deadline_s=deadline_s, question=question)
            first = self._port.read_exact(1, deadline_s=deadline_s, question=question)
            if first.isdigit():  # an address: Basic mode. As the length of a packet it would be beyond any reply.
                data = first + self._port.read_until(ETX, deadline_s=deadline_s, question=question)[:-1]
                break
            if SAFE_EXTRA < first[0] <= LONGEST_REPLY:
                rest = self._port.read_exact(first[0] - 1, deadline_s=deadline_s, question=question)
                data = rest[:-3]
                if rest[-1:] != ETX or crc(data) != int.from_bytes(rest[-3:-1], "big"):
                    raise DeviceProtocolError(
                        f"pump: the check value of its answer {data!r} is wrong; look for a loose plug or a cable beside "
                        "a motor"
                    )
                break
        reply = parse_reply(data)
        if reply.address != self._pump_number:
            raise DeviceProtocolError(
                f"pump: number {reply.address} answered, number {self._pump_number} was asked; set pump_number to "
                f"{reply.address} in section [pump]"
            )
        return reply

    def acknowledged(self, command: str) -> Reply:
        """Send ``command`` until it is answered without an alarm; an alarm swallows what it answers (page 42)."""
        for _ in range(ALARMS_IN_A_ROW):
            reply = self.exchange(command)
            if not reply.alarm:
                return reply
            self.alarms_acknowledged += 1
            self.last_alarm = reply.alarm
            log.warning("pump: alarm: %s", ALARMS[reply.alarm])
        raise self._keeps_ringing(reply.alarm)

    def _keeps_ringing(self, alarm: str) -> DeviceAlarmError:
        return DeviceAlarmError(f"pump: it keeps ringing: {ALARMS[alarm]}; look at the pump and clear it there")

    def ask(self, command: str) -> str:
        """Return the data that ``command`` asks for. Raises ``DeviceProtocolError`` when the pump refuses."""
        reply = self.acknowledged(command)
        self.refuse_error(command, reply)
        return reply.data

    def refuse_error(self, command: str, reply: Reply) -> None:
        """Raise when ``reply`` carries one of the pump's command errors (page 42)."""
        if not reply.data.startswith("?"):
            return
        if reply.data == "?OOR" and command.startswith("VOL"):
            raise OutOfVolumeError(f"pump: {command!r} is out of its range; ask for less")
        unknown = "it does not know this command; check the model"
        if command.startswith("SAF"):
            unknown = 'it has no Safe mode; set mode = "basic" in section [pump], and stay beside it while it pumps'
        reason = {
            "?NA": "it says that this is not applicable now; stop it and try again",
            "?OOR": "it says that this is out of range; compare pump_rate_ml_per_min and diameter_mm with its manual",
            "?COM": "the packet did not arrive whole; look for a loose plug or a cable beside a motor",
            "?IGN": "it was busy; try again",
        }.get(reply.data, unknown)
        raise DeviceProtocolError(f"pump: {command!r} was asked, {reason}")

    # Modes

    def enter_safe_mode(self, dead_man_s: int) -> None:
        """Arm the dead-man timer: from now on the pump stops itself when it hears nothing for ``dead_man_s``."""
        self._set_mode(dead_man_s)
        found = self.ask("SAF")
        if not found.isdigit() or int(found) != dead_man_s:
            raise DeviceProtocolError(
                f"pump: a dead-man time of {dead_man_s} s asked, it says {found!r}; nothing was started. Check the model"
            )

    def enter_basic_mode(self) -> tuple[str, ...]:
        """Bring the pump to Basic mode, whichever it is in, and return the alarms that waited there (page 33)."""
        return self._set_mode(0)

    def _set_mode(self, dead_man_s: int) -> tuple[str, ...]:
        # The pump understands a Safe-mode packet in either mode, and answers in the mode that it was told to enter.
        alarms: list[str] = []
        while (reply := self._exchange(f"SAF{dead_man_s}", safe=True, attempts=ATTEMPTS)).alarm:
            alarms.append(reply.alarm)
            if len(alarms) >= ALARMS_IN_A_ROW:
                raise self._keeps_ringing(reply.alarm)
        if dead_man_s or reply.data != "?":  # a model without Safe mode is in Basic mode already
            self.refuse_error(f"SAF{dead_man_s}", reply)
        self.safe = dead_man_s > 0
        return tuple(alarms)
