"""A linear stage behind a GRBL 1.1 controller.

Written from GRBL's documentation and proved against an emulator that a foreign client drives as well; it has not met
real hardware. Moves are jogs (``$J=G53 G90 G21 X.. F..``, ``doc/markdown/jogging.md``): they leave the controller's modes
alone, are refused instead of raising an alarm when they would leave the travel, and can be cancelled with one byte.
"""

import logging
from types import TracebackType

from drivers.errors import (
    DeviceAlarmError,
    DeviceError,
    DeviceProtocolError,
    DeviceTimeoutError,
    OutOfTravelError,
    UnknownPositionError,
)
from drivers.grbl_axis import AxisName, GrblAxis, read_axis
from drivers.grbl_link import GrblLink, GrblRefusal
from drivers.grbl_protocol import CANCEL_JOG, FEED_HOLD, GARBLED, STANDSTILLS, GrblStatus, read_code, reason_of
from drivers.protocols import Clock, DeviceInfo, DeviceKind
from drivers.serial_port import SerialPort, Trace

# "?" may be sent five to ten times a second (interface.md).
POLL_S = 0.15
HOMING_POLL_S = 0.05
STOP_S = 5.0

log = logging.getLogger(__name__)


class GrblStage:
    """Implements :class:`drivers.protocols.Stage` on one axis of the controller.

    Parameters
    ----------
    port
        Device path or URL of the serial port.
    travel_mm
        Smallest and largest position that may be driven to, in mm from where the carriage rests after homing.
        Positions grow away from the homing switch.
    velocity_mm_per_s
        Speed of the moves; the controller itself limits it to ``$110``.
    clock
        Measures the time limits of moves.
    axis
        The axis that carries the display.
    kind
        What the session records: ``emulated`` when an emulator answers.
    banner_s
        How long opening waits for the greeting: many boards restart when their port is opened (DTR), others do not.
    trace
        Hears everything on the wire, see :class:`drivers.serial_port.SerialPort`.

    Notes
    -----
    Opening never makes the position known: a board that restarted counts from zero wherever the carriage is, and says
    Idle all the same. Only :meth:`home` does, and any restart or alarm undoes it.
    """

    def __init__(
        self,
        port: str,
        *,
        travel_mm: tuple[float, float],
        velocity_mm_per_s: float,
        clock: Clock,
        axis: AxisName = "X",
        kind: DeviceKind = "real",
        banner_s: float = 2.0,
        trace: Trace | None = None,
    ) -> None:
        self._port = SerialPort(port, baud=115200, device="stage", trace=trace)
        self._link = GrblLink(self._port)
        self._travel_mm = travel_mm
        self._velocity_mm_per_s = velocity_mm_per_s
        self._clock = clock
        self._axis_name: AxisName = axis
        self._axis: GrblAxis  # read when the port is opened
        self._kind = kind
        self._banner_s = banner_s
        self._version = ""
        self._homes_one_axis = False
        self._offset_mm: tuple[float, ...] | None = None
        self._homed = False
        self._homing = False

    # Who it is

    def info(self) -> DeviceInfo:
        """Model, address and version of the controller that answers."""
        return DeviceInfo(self._kind, "GRBL linear stage", self._port.address, self._version)

    def travel_mm(self) -> tuple[float, float]:
        """Smallest and largest position."""
        return self._travel_mm

    def is_homed(self) -> bool:
        """Whether the position can be trusted: homed since the controller last started, and no alarm since."""
        if self._homed and self._port.is_open:
            self._link.catch_up()
            if self._link.alarm is not None or self._link.has_restarted:
                self._homed = False
        return self._homed

    def advice(self) -> tuple[str, ...]:
        """Return what could be better in the controller's settings; nothing here stops a capture."""
        return self._axis.advice(velocity_mm_per_s=self._velocity_mm_per_s)

    # Moving

    def home(self, *, timeout_s: float) -> None:
        """Find the reference switch; afterwards the position is known.

        Raises ``DeviceAlarmError`` when homing fails: GRBL says ``ok`` even then, so success is ``ok`` without an alarm
        and Idle afterwards (``doc/csv/alarm_codes_en_US.csv``, alarms 6 to 9).
        """
        if not self._axis.can_home:
            raise DeviceProtocolError(
                "stage: home asked, but homing is switched off in the controller ($22=0); send $22=1 once with a "
                "terminal program, after checking that the stage has a homing switch"
            )
        self._homed = False
        self._make_ready_to_home()
        self._homing = True
        try:
            self._link.send(b"$H" + (self._axis_name.encode() if self._homes_one_axis else b"") + b"\n")
            self._wait_until_homed(timeout_s)
        except BaseException:
            self._stop_quietly()
            raise
        finally:
            self._homing = False
        status = self._status()
        if status.state != "Idle":
            raise DeviceAlarmError(f"stage: homing ended, but the controller says {status.state}; home the stage again")
        self._homed = True

    def _make_ready_to_home(self) -> None:
        """Lead the controller out of an alarm or a standstill, in which it would keep the order to home for later."""
        self._link.catch_up()
        if self._link.alarm is not None or self._status().state in STANDSTILLS:
            self._link.reset()
            if (state := self._status().state) in STANDSTILLS:
                raise self._standing_still("homing", state)
        self._link.forget()

    def _wait_until_homed(self, timeout_s: float) -> None:
        deadline_s = self._clock.now_s() + timeout_s
        while True:
            text = self._link.listen()
            if self._link.alarm is not None:
                self._link.hears_banner_within(1.0)
                raise self._link.alarm_error()
            if self._link.has_restarted:
                raise self._disturbed("homing")
            if text == "ok":
                return
            if text is not None and (code := read_code(text, word="error")) is not None:
                raise DeviceProtocolError(f"stage: homing was refused with error:{code}: {reason_of(code)}")
            if text is None:
                if self._clock.now_s() >= deadline_s:
                    raise DeviceTimeoutError(
                        f"stage: homing was not over after {timeout_s:g} s; the stage was stopped. Allow more time, or "
                        "check switch and motor"
                    )
                self._clock.sleep_s(HOMING_POLL_S)

    def move_to_mm(self, position_mm: float, *, timeout_s: float) -> None:
        """Move and block until there. Raises ``OutOfTravelError`` or ``UnknownPositionError`` before any motion."""
        low_mm, high_mm = self._travel_mm
        if not low_mm <= position_mm <= high_mm:  # also refuses NaN
            raise OutOfTravelError(f"stage: {position_mm:g} mm asked, travel is {low_mm:g} to {high_mm:g} mm")
        if not self.is_homed():
            raise UnknownPositionError(
                f"stage: {position_mm:g} mm asked, but it was not homed since its port was opened or it restarted; home "
                "the stage first (rig stage move MM --home)"
            )
        # A line that is sent to a controller which stands still would be carried out when somebody lets it go on.
        self._raise_if_disturbed(self._status(), f"the move to {position_mm:g} mm")
        machine_mm = self._axis.machine_mm(position_mm)
        feed_mm_per_min = 60 * self._velocity_mm_per_s
        try:
            self._begin_jog(f"$J=G53G90G21{self._axis_name}{machine_mm:.3f}F{feed_mm_per_min:.1f}")
            self._wait_until_at(position_mm, timeout_s=timeout_s)
        except BaseException:
            self._stop_quietly()
            raise

    def _begin_jog(self, line: str) -> None:
        try:
            try:
                self._link.command(line)
            except DeviceTimeoutError:
                # Either the line or its ok was lost. The target is absolute: asking again is harmless.
                if self._status().state != "Jog":
                    self._link.command(line)
            except GrblRefusal as refusal:
                if refusal.code not in GARBLED:
                    raise
                self._link.command(line)
        except GrblRefusal as refusal:
            if refusal.code == 15:
                raise OutOfTravelError(str(refusal)) from refusal
            raise

    def _wait_until_at(self, position_mm: float, *, timeout_s: float) -> None:
        """Poll until the controller is idle twice in a row, then compare where it stands with where it should."""
        what = f"the move to {position_mm:g} mm"
        deadline_s = self._clock.now_s() + timeout_s
        idle_reports = 0
        while idle_reports < 2:
            status = self._status()
            self._raise_if_disturbed(status, what)
            idle_reports = idle_reports + 1 if status.state == "Idle" else 0
            if self._clock.now_s() >= deadline_s and idle_reports < 2:
                raise DeviceTimeoutError(
                    f"stage: {what} was not over after {timeout_s:g} s; the stage was stopped. Allow more time, or check "
                    "velocity_mm_per_s"
                )
            self._clock.sleep_s(POLL_S)
        # One step of the motor, and the last digit of the report.
        tolerance_mm = self._axis.step_mm + 0.001
        found_mm = self._position_mm(status)
        if abs(found_mm - position_mm) > tolerance_mm:
            raise DeviceProtocolError(
                f"stage: {what} ended at {found_mm:.3f} mm; something cancelled it or changed the command on the wire. "
                "Check cable and shielding, and that no other program talks to the controller; then move again"
            )

    def position_mm(self) -> float:
        """Ask the controller what it counts; raises ``DeviceAlarmError`` while an alarm keeps it from answering."""
        return self._position_mm(self._status())

    def stop(self) -> None:
        """Stop now: any time, twice, from ``finally``. During homing only a reset stops it."""
        if not self._port.is_open:
            return
        if self._homing:
            self._homed = False
            self._link.reset()
            return
        self._link.send(CANCEL_JOG)
        deadline_s = self._clock.now_s() + STOP_S
        while self._clock.now_s() < deadline_s:
            try:
                state = self._status().state
            except DeviceAlarmError:
                return  # it has stopped by itself
            if state not in ("Jog", "Run", "Home"):
                return
            self._link.send(FEED_HOLD if state == "Run" else CANCEL_JOG)
            self._clock.sleep_s(POLL_S)
        self._homed = False
        self._link.reset()

    def _stop_quietly(self) -> None:
        """Stop on the way out of a failure, which matters more than whether this worked."""
        try:
            self.stop()
        except DeviceError as error:
            log.warning("stage: not stopped: %s", error)

    # Reports

    def _position_mm(self, status: GrblStatus) -> float:
        place_mm = status.place[self._axis.number]
        if not status.is_machine:
            if self._offset_mm is None:
                raise DeviceProtocolError("stage: the controller reports work coordinates without offset; send $10=1")
            place_mm += self._offset_mm[self._axis.number]
        return self._axis.position_mm(place_mm)

    def _status(self) -> GrblStatus:
        status = self._link.status()
        if status.offset is not None:
            self._offset_mm = status.offset
        return status

    def _raise_if_disturbed(self, status: GrblStatus, what: str) -> None:
        if self._link.alarm is not None:
            self._homed = False
            raise self._link.alarm_error()
        if self._link.has_restarted or status.state == "Alarm":
            raise self._disturbed(what)
        if status.state in STANDSTILLS:
            raise self._standing_still(what, status.state)

    def _standing_still(self, what: str, state: str) -> DeviceAlarmError:
        self._homed = False
        return DeviceAlarmError(f"stage: {what} is held up, the controller says {state}: {STANDSTILLS[state]}")

    def _disturbed(self, what: str) -> DeviceAlarmError:
        self._homed = False
        return DeviceAlarmError(
            f"stage: the controller restarted during {what} and its position is lost; check power supply and USB cable, "
            "then home the stage"
        )

    # Opening and closing

    def __enter__(self) -> "GrblStage":
        self._port.open()
        try:
            self._greet()
            self._read_settings()
        except BaseException:
            self._port.close()
            raise
        for sentence in self.advice():
            log.warning("stage: %s", sentence)
        return self

    def _greet(self) -> None:
        self._homed = False
        self._link.hears_banner_within(self._banner_s)
        try:
            self._link.ask("")
            moving = self._status().state not in ("Idle", "Alarm")
        except (DeviceTimeoutError, DeviceAlarmError):
            moving = True  # or deaf after an alarm: a reset is the way out of both
        if moving:
            self._link.reset()
        if self._link.has_lost_settings:
            raise DeviceProtocolError(
                "stage: the controller has lost its settings (error:7) and runs on defaults; restore them from your notes"
            )
        identity = dict(
            line[1:-1].split(":", 1) for line in self._link.ask("$I") if line.startswith("[") and ":" in line
        )
        self._version = identity.get("VER", "").strip(":")
        self._homes_one_axis = "H" in identity.get("OPT", "").split(",")[0]
        self._link.forget()

    def _read_settings(self) -> None:
        if not self._version.startswith("1.1"):
            raise DeviceProtocolError(
                f"stage: GRBL 1.1 asked, version {self._version or 'unknown'} answers on {self._port.address}; check the "
                "port, or use a GRBL 1.1 firmware"
            )
        self._axis = read_axis(self._link.ask("$$"), name=self._axis_name)
        self._axis.check(self._travel_mm)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None:
                self.stop()
            else:
                self._stop_quietly()
        finally:
            self._port.close()
