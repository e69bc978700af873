"""A self-built tank board: relays for a pump, two safety contacts and a level sensor behind an open line protocol.

The protocol and the firmware are ours, see ``docs/how-to/build-a-pump-board.md``. This driver has met an emulator and the
firmware compiled for a computer, and not yet a real board.

The board stops the pump by itself: when the run time of the start is over, when no heartbeat came for a second, when the
leak contact or the over-fill contact opens. ``status`` is the heartbeat; no thread would send one for a program that
hangs.
"""

import logging
import math
import time
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType

from drivers.errors import (
    DeviceAlarmError,
    DeviceBusyError,
    DeviceError,
    DeviceNotFoundError,
    DeviceProtocolError,
    DeviceTimeoutError,
    OutOfVolumeError,
)
from drivers.protocols import DeviceInfo, DeviceKind, FlowDirection, PumpStatus
from drivers.serial_port import SerialPort, Trace, deadline_after
from drivers.tank_board_line import FAULTS, VERBS, BoardState, parse_line

IDENTITY = "tank-board/1"
# Two attempts must fit into the second that the board waits for a heartbeat.
ATTEMPTS = 2
# An Arduino is reset when its port opens and its bootloader then listens to nobody for up to two seconds.
WAKE_UP_S = 5.0
ASK_AGAIN_S = 0.5
STOP_ATTEMPTS = 3

log = logging.getLogger(__name__)


@dataclass(slots=True)
class Run:
    """The flow that was started last."""

    direction: FlowDirection
    run_ms: int
    over: bool = False
    fault: str = ""


class TankBoard:
    """A tank board on a serial port. Implements :class:`drivers.protocols.Pump` and, with ``level_points``,
    :class:`drivers.protocols.LevelSensor`; entering it once for each is fine.

    Parameters
    ----------
    address
        Device path or URL of the port.
    fill_ml_per_min, drain_ml_per_min
        What the pump moves, measured with a measuring cylinder: the board itself knows only times.
    level_points
        (counts, ml) of the level sensor, at least two; between them the level is interpolated, beyond them refused.
    """

    def __init__(
        self,
        address: str,
        *,
        fill_ml_per_min: float,
        drain_ml_per_min: float,
        level_points: Sequence[tuple[float, float]] = (),
        baud: int = 115200,
        reply_timeout_s: float = 0.3,
        kind: DeviceKind = "real",
        trace: Trace | None = None,
    ) -> None:
        for name, rate in (("fill_ml_per_min", fill_ml_per_min), ("drain_ml_per_min", drain_ml_per_min)):
            if not 0 < rate < math.inf:
                raise OutOfVolumeError(f"pump: {name} is {rate:g}, it must be above 0; measure it (rig pump calibrate)")
        self._port = SerialPort(address, baud=baud, device="pump", trace=trace)
        self._ml_per_s: dict[FlowDirection, float] = {"fill": fill_ml_per_min / 60, "drain": drain_ml_per_min / 60}
        self._level_points = sorted(level_points)
        self._reply_timeout_s = reply_timeout_s
        self._kind: DeviceKind = kind
        self._entered = 0
        self._run: Run | None = None

    # Opening and leaving

    def __enter__(self) -> "TankBoard":
        if self._entered == 0:
            self._port.open()
            self._run = None  # what ended an earlier conversation was told there
            try:
                self._wait_until_awake()
                self.stop()
            except BaseException:
                self._port.close()
                raise
        self._entered += 1
        return self

    def _wait_until_awake(self) -> None:
        deadline_s = deadline_after(WAKE_UP_S)
        while True:
            try:
                line = self._exchange("ID?", timeout_s=ASK_AGAIN_S, attempts=1)
            except DeviceTimeoutError as error:
                if time.monotonic() < deadline_s:
                    continue
                raise DeviceNotFoundError(
                    f"pump: no tank board answers on {self._port.address}; check the cable, and that the sketch tank_board is "
                    "on the board"
                ) from error
            break
        if line.identity != IDENTITY:
            raise DeviceProtocolError(
                f"pump: the board calls itself {line.identity!r}, this driver speaks {IDENTITY!r}; upload the sketch again"
            )

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._entered -= 1
        try:
            self.stop()
        except DeviceError as stop_error:
            if error is None:
                raise
            log.error("%s", stop_error)
        finally:
            if self._entered == 0:
                self._port.close()

    def info(self) -> DeviceInfo:
        """Model, address and version of the protocol."""
        model, _, version = IDENTITY.partition("/")
        return DeviceInfo(self._kind, model, self._port.address, version)

    def rehearse(self) -> str:
        """Look at both safety contacts, with nothing flowing, and say what was proven.

        Raises
        ------
        DeviceAlarmError
            When one of them is open.
        """
        state = self._exchange("STATE?")
        if state.leak_open:
            raise DeviceAlarmError(f"pump: {FAULTS['leak']}; wipe it dry and look for the cause")
        if state.full_open:
            raise DeviceAlarmError(f"pump: {FAULTS['full']}; drain the tank, or mend the wire")
        return "leak contact and over-fill contact are closed"

    # Pumping

    def start(self, direction: FlowDirection, *, volume_ml: float, max_run_s: float) -> None:
        """Begin to move ``volume_ml``, or what the pump moves in ``max_run_s`` where that is less.

        Raises
        ------
        OutOfVolumeError
            For a volume or time that is not positive or beyond the board's cap, and when the over-fill contact is open.
        DeviceBusyError
            While the pump runs.
        DeviceAlarmError
            When the leak contact is open.
        """
        run_ms = self._run_ms(direction, volume_ml=volume_ml, max_run_s=max_run_s)
        state = self._exchange("STATE?")
        if state.direction is not None:
            raise DeviceBusyError(
                f"pump: a {direction} asked while a {state.direction} is running; stop it first (rig pump stop)"
            )
        self.stop()
        self._run = Run(direction, run_ms)
        try:
            self._switch_on(direction, run_ms)
        except BaseException:
            self._run.over = True
            self.stop()
            raise

    def _run_ms(self, direction: FlowDirection, *, volume_ml: float, max_run_s: float) -> int:
        if not 0 < volume_ml < math.inf:
            raise OutOfVolumeError(f"pump: {volume_ml:g} ml asked, a {direction} needs a volume above 0 ml")
        if not 0 < max_run_s < math.inf:
            raise OutOfVolumeError(f"pump: a longest run of {max_run_s:g} s asked, it must be above 0 s")
        run_ms = round(1000 * min(volume_ml / self._ml_per_s[direction], max_run_s))
        if run_ms == 0:
            raise OutOfVolumeError(
                f"pump: {volume_ml:g} ml asked, that is less than a millisecond of pumping; ask for more"
            )
        return run_ms

    def _switch_on(self, direction: FlowDirection, run_ms: int) -> None:
        """Send the start once, never twice, and believe only what the board says of itself."""
        try:
            state = self._exchange(f"{VERBS[direction]} {run_ms}", attempts=1)
        except DeviceTimeoutError as error:
            log.warning("pump: no answer to the start (%s); asking for its state", error)
            state = self._exchange("HB")
        if state.why:
            raise self._refused(direction, run_ms, state.why)
        if state.direction != direction or not 0 < state.ran_ms + state.left_ms <= run_ms:
            raise DeviceProtocolError(
                f"pump: a {direction} of {run_ms} ms was asked, the board says {state.text!r}; it was told to stop. "
                "Check the cable and try again"
            )

    @staticmethod
    def _refused(direction: FlowDirection, run_ms: int, why: str) -> DeviceError:
        if why == "time":
            return OutOfVolumeError(
                f"pump: a {direction} would take {run_ms / 1000:g} s, the board allows half an hour; pump less at a time"
            )
        if why == "full":
            return OutOfVolumeError(f"pump: a fill asked, but {FAULTS['full']}; drain the tank first")
        if why == "leak":
            return DeviceAlarmError(
                f"pump: a {direction} asked, but {FAULTS['leak']}; wipe it dry and look for the cause"
            )
        reason = {"busy": "it pumps already", "fault": "it was reset since it was told to stop"}.get(why, why)
        return DeviceProtocolError(
            f"pump: the board refuses a {direction} ({reason}); stop it and try again (rig pump stop)"
        )

    def status(self) -> PumpStatus:
        """Ask the board; while the pump runs this is also the heartbeat that the board waits for.

        Raises
        ------
        DeviceAlarmError
            When the board was reset during a run: what the pump has moved is then unknown.
        """
        run = self._run
        state = self._exchange("HB")
        if run is None:
            return PumpStatus(state.direction is not None, state.direction, 0.0, FAULTS.get(state.fault, ""))
        if not run.over and state.direction is None:
            run.over, run.fault = True, state.fault
        if run.fault == "reset":
            raise DeviceAlarmError(
                f"pump: {FAULTS['reset']} during a {run.direction}, so the volume in the tank is unknown; look at the tank, "
                "then say what it holds (rig pump level ML)"
            )
        fault = run.fault if run.fault != "none" else state.fault
        moved_ml = state.ran_ms / 1000 * self._ml_per_s[run.direction]
        return PumpStatus(state.direction is not None, state.direction, moved_ml, FAULTS.get(fault, ""))

    def stop(self) -> None:
        """Stop now and believe it only when the board says so; harmless when it stands or was never opened.

        Raises
        ------
        DeviceError
            When the board did not confirm; it stops the pump by itself then, within a second.
        """
        if not self._port.is_open:
            return
        run = self._run
        try:
            for _ in range(STOP_ATTEMPTS):
                state = self._exchange("STOP")
                if run is not None and not run.over:
                    run.over, run.fault = True, state.fault
                if state.direction is None:
                    return
        except DeviceError as error:
            cause = str(error).removeprefix("pump: ")
            raise type(error)(
                "pump: it did not confirm the stop; if it still turns, the board stops it within a second, since it gets no "
                f"heartbeats. Cause: {cause}"
            ) from error
        raise DeviceTimeoutError(
            f"pump: told {STOP_ATTEMPTS} times to stop, the board says {state.text!r}; switch the pump off at the mains"
        )

    # Level

    def volume_ml(self) -> float:
        """What the tank holds, interpolated between the calibrated points.

        Raises
        ------
        DeviceProtocolError
            Without calibration, or when the sensor reads something beyond the calibrated points.
        """
        points = self._level_points
        if len(points) < 2:
            raise DeviceProtocolError(
                "level sensor: it has no calibration; give at least two pairs of counts and ml (level_points)"
            )
        counts = self._exchange("LEVEL?").level
        if not points[0][0] <= counts <= points[-1][0]:
            raise DeviceProtocolError(
                f"level sensor: it reads {counts}, calibrated is {points[0][0]:g} to {points[-1][0]:g}; look at its wire, "
                "or calibrate it further"
            )
        above = max(1, bisect_left([point[0] for point in points], counts))
        (low, low_ml), (high, high_ml) = points[above - 1], points[above]
        return low_ml + (high_ml - low_ml) * (counts - low) / (high - low)

    # The wire

    def _exchange(self, question: str, *, timeout_s: float | None = None, attempts: int = ATTEMPTS) -> BoardState:
        """Send one line and return the reply that names it; anything else that arrives is noise or news."""
        with self._port.transaction():
            for attempt in range(1, attempts + 1):
                self._port.flush_input()
                self._port.write(question.encode("ascii") + b"\n")
                try:
                    return self._answer_to(question, deadline_after(timeout_s or self._reply_timeout_s))
                except DeviceTimeoutError as error:
                    if attempt == attempts:
                        raise
                    log.info("%s; asking again", error)
        raise AssertionError("unreachable: the last attempt returns or raises")

    def _answer_to(self, question: str, deadline_s: float) -> BoardState:
        verb = question.partition(" ")[0]
        while True:
            line = self._port.read_until(b"\n", deadline_s=deadline_s, question=f"the answer to {question}")
            state = parse_line(line)
            if state is not None and state.verb == verb:
                return state
            log.info("pump: passed over %r", line)
