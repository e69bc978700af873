"""New Era pumps: NE-1000 syringe pumps and NE-9000 peristaltic pumps, over a serial port.

Written from the manuals NE-9000 (publication 1200-04) pages 40 to 48 and NE-1000 (1200-01) pages 33 and 34. This driver
has met an emulator and not yet a real pump.

Three things end a flow, each without the others: the volume that the pump counts, ``max_run_s`` (the volume sent is
never more than the rate moves in that time), and in Safe mode the pump's own dead-man timer, which stops it when nobody
asks for its status any more. There is no thread that would keep the timer alive for a program that hangs.
"""

import logging
import time
from dataclasses import dataclass
from types import TracebackType
from typing import Literal

from drivers.errors import (
    DeviceAlarmError,
    DeviceBusyError,
    DeviceError,
    DeviceNotFoundError,
    DeviceProtocolError,
    DeviceTimeoutError,
)
from drivers.new_era_link import NewEraLink
from drivers.new_era_settings import (
    FLOW,
    Settings,
    dispensed_ml,
    forbid_restart_after_power_failure,
    prepare,
    settings_for,
)
from drivers.new_era_wire import ALARMS, RUNNING_PROMPTS
from drivers.protocols import DeviceInfo, DeviceKind, FlowDirection, PumpStatus
from drivers.serial_port import SerialPort, Trace

# A stop is repeated until the pump says that it stands; the first STP pauses, the second one stops (NE-9000 page 45).
STOP_ATTEMPTS = 5
# The counter's four digits may fall short of the volume's four digits by their rounding.
COMPLETE = 0.999
DIRECTION_OF: dict[str, FlowDirection] = {flow.prompt: direction for direction, flow in FLOW.items()}
LONGEST_DEAD_MAN_S = 255

log = logging.getLogger(__name__)


@dataclass(slots=True)
class Run:
    """The flow that was started last; ``over`` once the pump was seen standing."""

    direction: FlowDirection
    settings: Settings
    ends_s: float
    over: bool = False
    alarm: str = ""
    why_early: str = ""


class NewEraPump:
    """A New Era pump on a serial port. Implements :class:`drivers.protocols.Pump`.

    Parameters
    ----------
    address
        Device path or URL of the port.
    rate_ml_per_min
        Flow rate; the pump's own calibration (tubing or syringe) turns it into speed.
    diameter_mm
        Inside diameter of the tubing or syringe; the pump chooses its units by it.
    mode
        ``safe``: packets with check values, and the pump stops by itself when it hears nothing for ``dead_man_s``.
        ``basic``: plain text without either; a computer that dies leaves the pump running until its volume is moved.
    dead_man_s
        Whole seconds; ``status`` must be called more often than that while the pump runs.
    pump_number
        The pump's address on its network, 0 unless it was changed.
    """

    def __init__(
        self,
        address: str,
        *,
        rate_ml_per_min: float,
        diameter_mm: float,
        mode: Literal["safe", "basic"] = "safe",
        dead_man_s: int = 5,
        baud: int = 19200,
        pump_number: int = 0,
        reply_timeout_s: float = 1.0,
        kind: DeviceKind = "real",
        trace: Trace | None = None,
    ) -> None:
        if not 1 <= dead_man_s <= LONGEST_DEAD_MAN_S:
            raise DeviceProtocolError(
                f"pump: a dead-man time of {dead_man_s} s asked, the pump takes 1 to {LONGEST_DEAD_MAN_S} s; 5 s is usual"
            )
        self._port = SerialPort(address, baud=baud, device="pump", trace=trace)
        self._link = NewEraLink(self._port, pump_number=pump_number, reply_timeout_s=reply_timeout_s)
        self._rate_ml_per_min = rate_ml_per_min
        self._diameter_mm = diameter_mm
        self._dead_man_s = dead_man_s if mode == "safe" else 0
        self._kind: DeviceKind = kind
        self._version = ""
        self._run: Run | None = None

    # Opening and leaving

    def __enter__(self) -> "NewEraPump":
        self._port.open()
        self._run = None  # what ended an earlier conversation was told there
        try:
            # The pump may be as a program that died has left it: in Safe mode, with an alarm, even running.
            alarms = self._link.enter_basic_mode()
            for alarm in alarms:
                # A pump that was switched on, or whose program died, has rung as it should; the others are faults.
                level = logging.WARNING if alarm in "RT" else logging.ERROR
                log.log(level, "pump: %s since it was last used; look at the tank before a fill", ALARMS[alarm])
            self._version = self._link.ask("VER")
            if not self._version.startswith("NE"):
                raise DeviceProtocolError(
                    f"pump: {self._port.address} answers {self._version!r} when asked who it is; "
                    "this driver knows New Era pumps (NE-...)"
                )
            self._stand_still()
        except DeviceTimeoutError as error:
            self._port.close()
            raise DeviceNotFoundError(
                f"pump: nothing answers on {self._port.address}; switch the pump on, and compare baud rate and pump number "
                "with those in its own menu"
            ) from error
        except BaseException:
            self._port.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.stop()
        except DeviceError as stop_error:
            if error is None:
                raise
            log.error("%s", stop_error)
        finally:
            self._port.close()

    def info(self) -> DeviceInfo:
        """Model and version as the pump itself says."""
        model, _, version = self._version.removeprefix("NE").partition("V")
        return DeviceInfo(self._kind, f"New Era NE-{model}", self._port.address, version)

    def rehearse(self) -> str:
        """Have the pump take and give back its safety settings, with nothing flowing, and say what was proven.

        Raises
        ------
        DeviceProtocolError
            When it would start by itself after a power failure, or does not take the dead-man time.
        """
        self._stand_still()
        forbid_restart_after_power_failure(self._link)
        proven = "does not start by itself after a power failure"
        if self._dead_man_s:
            self._link.enter_safe_mode(self._dead_man_s)
            self._link.enter_basic_mode()
            proven += f", stops by itself when it hears nothing for {self._dead_man_s} s"
        return proven

    # Pumping

    def start(self, direction: FlowDirection, *, volume_ml: float, max_run_s: float) -> None:
        """Begin to move ``volume_ml``, or what the pump moves in ``max_run_s`` where that is less.

        Raises
        ------
        OutOfVolumeError
            For a volume or time that is not positive, or that the pump's four digits cannot hold.
        DeviceBusyError
            While the pump runs.
        DeviceProtocolError
            When a setting reads back other than it was sent; nothing flows then.
        DeviceAlarmError
            When the pump rings instead of starting.
        """
        settings = settings_for(
            direction,
            volume_ml=volume_ml,
            max_run_s=max_run_s,
            rate_ml_per_min=self._rate_ml_per_min,
            diameter_mm=self._diameter_mm,
        )
        prompt = self._quiet_prompt()
        if prompt in RUNNING_PROMPTS:
            raise DeviceBusyError(
                f"pump: a {direction} asked while it is {RUNNING_PROMPTS[prompt]}; stop it first (rig pump stop)"
            )
        self._stand_still()
        prepare(self._link, settings)
        if self._dead_man_s:
            self._link.enter_safe_mode(self._dead_man_s)
        self._run = Run(direction, settings, ends_s=time.monotonic() + max_run_s)
        try:
            self._switch_on(direction)
        except BaseException:
            self._run.over = True
            self.stop()
            raise

    def _switch_on(self, direction: FlowDirection) -> None:
        """Send RUN once, never twice, and believe only what the status says afterwards."""
        try:
            reply = self._link.exchange("RUN", attempts=1)
        except (DeviceTimeoutError, DeviceProtocolError) as error:
            log.warning("pump: no answer to RUN (%s); asking for its status", error)
        else:
            if reply.alarm:
                raise DeviceAlarmError(
                    f"pump: rang instead of starting: {ALARMS[reply.alarm]}; nothing flows. Look at the pump and try again"
                )
            self._link.refuse_error("RUN", reply)
        status = self._link.exchange("")
        wanted = FLOW[direction].prompt
        if status.alarm:
            raise DeviceAlarmError(f"pump: stopped at once: {ALARMS[status.alarm]}; look at the pump and the tubing")
        # A small volume may be moved before the question arrives.
        moved_ml = self._counted_ml(direction)
        if status.prompt != wanted and moved_ml <= 0:
            raise DeviceTimeoutError(
                f"pump: a {direction} was asked, but the pump says {status.prompt!r} and counts nothing; it was told to "
                "stop. Check the cable and try again"
            )

    def status(self) -> PumpStatus:
        """Ask the pump; while it runs in Safe mode this is also the sign of life that it waits for.

        Raises
        ------
        DeviceAlarmError
            When the pump lost its power during a run: what it has moved is then unknown.
        """
        run = self._run
        prompt = self._quiet_prompt()
        if run is None:
            return PumpStatus(prompt in RUNNING_PROMPTS, DIRECTION_OF.get(prompt), 0.0)
        if prompt in RUNNING_PROMPTS and not run.over and time.monotonic() > run.ends_s:
            self.stop()
            prompt = "S"
        if run.alarm == "R":
            raise DeviceAlarmError(
                f"pump: its power was interrupted during a {run.direction}, so the volume in the tank is unknown; "
                "look at the tank, then say what it holds (rig pump level ML)"
            )
        known = run.alarm
        moved_ml = self._counted_ml(run.direction)
        if run.alarm != known:  # it rang between the two questions, and what it counts may have begun anew
            return self.status()
        if prompt in RUNNING_PROMPTS:
            return PumpStatus(True, DIRECTION_OF.get(prompt), moved_ml)
        if not run.over:
            run.over = True
            run.why_early = self._why_early(run, moved_ml)
        return PumpStatus(False, None, moved_ml, run.why_early)

    def _counted_ml(self, direction: FlowDirection) -> float:
        """Return what the pump counts; an alarm that came instead at first is remembered, since the pump forgets it."""
        rung = self._link.alarms_acknowledged
        moved_ml = dispensed_ml(self._link, direction)
        if self._link.alarms_acknowledged > rung:
            self._note_alarm(self._link.last_alarm)
        return moved_ml

    def _why_early(self, run: Run, moved_ml: float) -> str:
        if moved_ml >= COMPLETE * run.settings.volume_ml:
            return ""  # an alarm that came later did not end this run
        if run.alarm == "T":
            return f"nobody asked for its status for {self._dead_man_s} s, so it stopped itself (dead-man timer)"
        return ALARMS[run.alarm] if run.alarm else "somebody stopped it at its own keys"

    def _quiet_prompt(self) -> str:
        """Return the prompt, past any alarm; an alarm during a run is remembered."""
        reply = self._link.exchange("")
        if reply.alarm:
            self._note_alarm(reply.alarm)
            reply = self._link.acknowledged("")
        return reply.prompt

    def _note_alarm(self, alarm: str) -> None:
        if self._run is not None and not self._run.over and not self._run.alarm:
            self._run.alarm = alarm

    # Stopping

    def stop(self) -> None:
        """Stop now and believe it only when the pump says so; harmless when it stands or was never opened.

        Raises
        ------
        DeviceError
            When the pump did not confirm; the message says what will end the flow.
        """
        if not self._port.is_open:
            return
        run = self._run
        try:
            self._stand_still()
            if run is not None and not run.over:
                run.over = True
                if run.alarm:
                    run.why_early = self._why_early(run, dispensed_ml(self._link, run.direction))
            # Without this the pump would ring after every pause between two flows.
            if self._link.safe:
                self._link.enter_basic_mode()
        except DeviceError as error:
            end = (
                f"it stops by itself within {self._dead_man_s} s (dead-man timer)"
                if self._dead_man_s
                else "in Basic mode it goes on until its volume is moved: switch it off at the mains"
            )
            cause = str(error).removeprefix("pump: ")
            raise type(error)(f"pump: it did not confirm the stop; if it still turns, {end}. Cause: {cause}") from error

    def _stand_still(self) -> None:
        for _ in range(STOP_ATTEMPTS):
            reply = self._link.exchange("STP")
            if reply.alarm:
                self._note_alarm(reply.alarm)
            elif reply.prompt == "S" and self._quiet_prompt() == "S":
                return
        raise DeviceTimeoutError(f"pump: told {STOP_ATTEMPTS} times to stop, it still says {reply.prompt!r}")
