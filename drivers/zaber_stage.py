"""A Zaber linear stage, spoken to in Zaber's ASCII protocol.

Written from the protocol's manual and proved against an emulator that Zaber's own library drives as well; it has not
met real hardware. Microsteps never leave this module. Moves are absolute; ``move vel``, which has no end, is never used.
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
from drivers.protocols import Clock, DeviceInfo, DeviceKind
from drivers.serial_port import SerialPort, Trace
from drivers.zaber_link import ZaberLink
from drivers.zaber_protocol import CONCERNS, FAULTS, NOT_HOMED, ZaberMessage, read_flags

KNOWN_FLAGS = FAULTS | CONCERNS | NOT_HOMED
POLL_S = 0.05
STOP_S = 5.0
# The unit of maxspeed: data value = 1.6384 × microsteps a second.
SPEED_PER_MICROSTEP_PER_S = 1.6384

log = logging.getLogger(__name__)


class ZaberStage:
    """Implements :class:`drivers.protocols.Stage` on one axis of a device.

    Parameters
    ----------
    port
        Device path or URL of the serial port.
    microstep_mm
        What one microstep moves, from the data sheet of the stage: an X-LSM has 0.000047625 mm.
    travel_mm
        Smallest and largest position that may be driven to; position 0 is where the device homes.
    velocity_mm_per_s
        Speed of the moves; written to the device's ``maxspeed`` where it differs.
    clock
        Measures the time limits of moves.
    device, axis
        Their numbers in the chain.
    kind
        What the session records: ``emulated`` when an emulator answers.
    trace
        Hears everything on the wire, see :class:`drivers.serial_port.SerialPort`.

    Notes
    -----
    The device itself remembers whether it was homed (warning flags WR and WH), also when the port was closed meanwhile.
    """

    def __init__(
        self,
        port: str,
        *,
        microstep_mm: float,
        travel_mm: tuple[float, float],
        velocity_mm_per_s: float,
        clock: Clock,
        device: int = 1,
        axis: int = 1,
        kind: DeviceKind = "real",
        trace: Trace | None = None,
    ) -> None:
        self._port = SerialPort(port, baud=115200, device="stage", trace=trace)
        self._link = ZaberLink(self._port, device=device, axis=axis)
        self._microstep_mm = microstep_mm
        self._travel_mm = travel_mm
        self._velocity_mm_per_s = velocity_mm_per_s
        self._clock = clock
        self._kind = kind
        self._model = "Zaber linear stage"
        self._version = ""

    # Who it is

    def info(self) -> DeviceInfo:
        """Model, address and version of the device that answers."""
        return DeviceInfo(self._kind, self._model, self._port.address, self._version)

    def travel_mm(self) -> tuple[float, float]:
        """Smallest and largest position."""
        return self._travel_mm

    def is_homed(self) -> bool:
        """Whether the position can be trusted, asked from the device's own warning flags."""
        flags = self._flags()
        return not flags & NOT_HOMED.keys() and not flags & (FAULTS.keys() - {"NI"})

    # Moving

    def home(self, *, timeout_s: float) -> None:
        """Find the reference switch; afterwards the position is known."""
        self._link.ask("warnings clear")
        self._drive("home", timeout_s=timeout_s, what="homing")
        if not self.is_homed():
            raise DeviceAlarmError(
                f"stage: homing ended, but the device still warns with {self._named(self._flags())}; check the power "
                "supply, then home the stage again"
            )

    def move_to_mm(self, position_mm: float, *, timeout_s: float) -> None:
        """Move and block until there. Raises ``OutOfTravelError`` or ``UnknownPositionError`` before any motion."""
        low_mm, high_mm = self._travel_mm
        if not low_mm <= position_mm <= high_mm:  # also refuses NaN
            raise OutOfTravelError(f"stage: {position_mm:g} mm asked, travel is {low_mm:g} to {high_mm:g} mm")
        flags = self._flags()
        if flags & NOT_HOMED.keys():
            raise UnknownPositionError(
                f"stage: {position_mm:g} mm asked, but it was not homed since it was switched on; home the stage first "
                "(rig stage home)"
            )
        what = f"the move to {position_mm:g} mm"
        self._raise_if_faulty(flags - {"NI"}, f"before {what}")
        self._link.ask("warnings clear")
        target = round(position_mm / self._microstep_mm)
        self._drive(f"move abs {target}", timeout_s=timeout_s, what=what)
        if self._flags() & NOT_HOMED.keys():
            raise DeviceAlarmError(
                f"stage: the device restarted during {what} and its position is lost; check the power supply, then home "
                "the stage"
            )
        found = self._microsteps(self._link.ask("get pos"))
        if abs(found - target) > 1:
            raise DeviceProtocolError(
                f"stage: {what} ended at {found * self._microstep_mm:.4f} mm; something moved it meanwhile. Check that no "
                "other program talks to the device and that nobody turns its knob; then move again"
            )

    def _drive(self, words: str, *, timeout_s: float, what: str) -> None:
        """Begin a movement and poll until the device is idle; then its warning flags say whether it succeeded."""
        deadline_s = self._clock.now_s() + timeout_s
        try:
            busy = self._begin(words)
            while busy:
                if self._clock.now_s() >= deadline_s:
                    raise DeviceTimeoutError(
                        f"stage: {what} was not over after {timeout_s:g} s; the stage was stopped. Allow more time, or "
                        "check velocity_mm_per_s"
                    )
                self._clock.sleep_s(POLL_S)
                busy = self._link.ask("").busy
            self._raise_if_faulty(self._flags(), f"during {what}")
        except BaseException:
            self._stop_quietly()
            raise

    def _begin(self, words: str) -> bool:
        """Send a movement once; when its reply is lost, look whether the device moves before saying it again."""
        try:
            return self._link.say(words).busy
        except DeviceTimeoutError:
            return self._link.ask("").busy or self._link.say(words).busy

    def position_mm(self) -> float:
        """Ask the device, never a cache."""
        return self._microsteps(self._link.ask("get pos")) * self._microstep_mm

    def stop(self) -> None:
        """Stop now: any time, twice, from ``finally``; returns when it stands."""
        if not self._port.is_open:
            return
        deadline_s = self._clock.now_s() + STOP_S
        self._link.ask("stop")
        while self._link.ask("").busy:
            if self._clock.now_s() >= deadline_s:
                raise DeviceTimeoutError(
                    f"stage: it still moves {STOP_S:g} s after it was told to stop; press the emergency stop"
                )
            self._clock.sleep_s(POLL_S)

    def _stop_quietly(self) -> None:
        """Stop on the way out of a failure, which matters more than whether this worked."""
        try:
            self.stop()
        except DeviceError as error:
            log.warning("stage: not stopped: %s", error)

    # Flags and numbers

    def _flags(self) -> set[str]:
        return read_flags(self._link.ask("warnings").data)

    def _raise_if_faulty(self, flags: set[str], when: str) -> None:
        if faults := flags & FAULTS.keys():
            raise DeviceAlarmError(f"stage: {when} the device warned with {self._named(faults)}")
        if concerns := flags & CONCERNS.keys():
            log.warning("stage: %s the device warned with %s", when, self._named(concerns))

    def _named(self, flags: set[str]) -> str:
        return ", ".join(f"{flag}: {KNOWN_FLAGS.get(flag, 'see the manual')}" for flag in sorted(flags))

    def _microsteps(self, reply: ZaberMessage) -> int:
        try:
            return int(reply.data)
        except ValueError:
            raise DeviceProtocolError(
                f"stage: a number asked, {reply.data!r} found; check that this is one axis of a Zaber stage"
            ) from None

    # Opening and closing

    def __enter__(self) -> "ZaberStage":
        self._port.open()
        try:
            self._identify()
            self._check_travel()
            self._set_speed()
        except BaseException:
            self._port.close()
            raise
        return self

    def _identify(self) -> None:
        if self._link.ask("").busy:
            self.stop()
        self._model = f"Zaber device {self._link.ask('get deviceid', of_axis=False).data}"
        self._version = self._link.ask("get version", of_axis=False).data

    def _check_travel(self) -> None:
        lowest_mm = self._microsteps(self._link.ask("get limit.min")) * self._microstep_mm
        highest_mm = self._microsteps(self._link.ask("get limit.max")) * self._microstep_mm
        low_mm, high_mm = self._travel_mm
        slack_mm = self._microstep_mm
        if not (lowest_mm - slack_mm <= low_mm and high_mm <= highest_mm + slack_mm):
            raise DeviceProtocolError(
                f"stage: travel_mm is {low_mm:g} to {high_mm:g} mm, the device allows {lowest_mm:g} to {highest_mm:g} mm "
                "(limit.min and limit.max); correct travel_mm, or microstep_mm if it is not that of this stage"
            )

    def _set_speed(self) -> None:
        wanted = round(self._velocity_mm_per_s / self._microstep_mm * SPEED_PER_MICROSTEP_PER_S)
        if self._microsteps(self._link.ask("get maxspeed")) != wanted:
            self._link.ask(f"set maxspeed {wanted}")

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
