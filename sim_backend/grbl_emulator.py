"""A GRBL 1.1h controller as its serial port sees it, moving the stage of the shared world.

Written from GRBL's documentation (``doc/markdown/interface.md``, ``commands.md``, ``jogging.md``, ``settings.md``
and the error and alarm tables of gnea/grbl), and from transcripts of the firmware. The X axis carries the display; Y
and Z are counted and carry nothing.
"""

import threading
from collections.abc import Callable, Generator, Mapping

from sim_backend.grbl_axes import Block, GrblAxes
from sim_backend.grbl_gcode import GrblError, Modes, Order, read_jog, read_line, strip_comments
from sim_backend.grbl_homing import GrblFaults, homing_cycle
from sim_backend.grbl_input import RX_BUFFER, GrblInput
from sim_backend.grbl_report import HELP, GrblReporter, greeting
from sim_backend.grbl_settings import GrblSettings, well_set_up
from sim_backend.world import World

LONGEST_LINE = 79
PLANNER_BLOCKS = 15
RESET_ADVICE_S = 0.5  # from ALARM:1 or 2 to the advice to reset
SAFETY_DOOR = 0x84
HOLD_S = 0.1  # until an axis has come to rest


class GrblEmulator:
    """Implements :class:`sim_backend.wire.Emulator`.

    Parameters
    ----------
    world
        Its stage is the X axis.
    travel_mm
        Where on the world's stage the carriage rests after homing, and how far it may go from there.
    settings
        What the EEPROM holds beyond :func:`sim_backend.grbl_settings.well_set_up`.
    build_options
        The letters of ``[OPT:]``: ``V`` variable spindle, ``H`` single-axis homing (``$HX``).
    version
        What ``$I`` says; the greeting says it without its date.

    Attributes
    ----------
    door_is_open
        The contact of the safety door: while it is open, nothing moves and no line is read.
    """

    def __init__(
        self,
        world: World,
        *,
        travel_mm: tuple[float, float],
        settings: Mapping[int, int | float] | None = None,
        build_options: str = "VH",
        version: str = "1.1h.20190830",
    ) -> None:
        low_mm, high_mm = travel_mm
        pull_off_mm = 1.0
        good = well_set_up(high_mm - low_mm, pull_off_mm=pull_off_mm)
        self.settings = GrblSettings(good | dict(settings or {}))
        self.faults = GrblFaults()
        self.build_options = build_options
        self.version = version
        self.door_is_open = False
        self.axes = GrblAxes(world, switch_mm=low_mm - pull_off_mm, far_mm=high_mm + 1.0)
        self.input = GrblInput()
        self._reporter = GrblReporter(self.settings)
        self._homing: Generator[None, None, int]
        self._world = world
        self._lock = threading.RLock()
        self._said = ""
        self._power_up()

    # The wire

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the host; realtime commands act at once, lines in their order."""
        with self._lock:
            for byte in data:
                self._advance()
                self._hear(byte)
            return self._speak()

    def poll(self) -> bytes:
        """Return answers that were held up, alarms and messages whose time has come."""
        with self._lock:
            self._advance()
            return self._speak()

    def _speak(self) -> bytes:
        said, self._said = self._said, ""
        return said.encode("ascii")

    def _say(self, text: str) -> None:
        self._said += text

    # What happens to the machine from outside

    def power_cycle(self) -> None:
        """Switch off and on, or let DTR reset the board: the count starts at zero wherever the carriage is."""
        with self._lock:
            self.axes.forget_plan()
            self._said = ""
            self._power_up()

    def hit_hard_limit(self) -> None:
        """Press a limit switch while the machine moves."""
        with self._lock:
            self._critical_alarm(1)

    def open_door(self) -> None:
        """Open the safety door, and leave it open."""
        with self._lock:
            self.door_is_open = True
            self._stop_at_door()

    def push(self, distance_mm: float) -> None:
        """Displace the carriage by hand; nothing counts it."""
        with self._lock:
            self.axes.push(distance_mm)

    # Power and reset

    def _power_up(self) -> None:
        self.axes.count_from_here(0.0)
        self._begin_again("Alarm" if self.settings[22] else "Idle")
        if self.faults.eeprom_is_corrupt:
            self._say("error:7\r\n" + self.settings.listing())
        self._say(self._greeting())

    def _begin_again(self, state: str) -> None:
        self._state = state
        self._dead = False  # ALARM 1 and 2: everything but a reset is ignored
        self._modes = Modes()
        self._offset_mm = (0.0, 0.0, 0.0)
        self.input.clear()
        self._waits: Callable[[], bool] | None = None  # holds up the line that is being executed
        self._advice_s: float | None = None
        self._hold_ends_s = 0.0
        self._reporter.forget()

    def _reset(self) -> None:
        """Answer 0x18: a machine that moves loses its place, one that stands keeps it."""
        moving = self.axes.is_moving() or self._state in ("Home", "Hold")
        if moving:
            self._say(f"ALARM:{6 if self._state == 'Home' else 3}\r\n")
        locked = moving or self._state in ("Alarm", "Sleep") or self._dead
        held_up = self._waits is not None
        self.axes.forget_plan()
        self._begin_again("Alarm" if locked else "Idle")
        # The line that was being executed is answered late, before the banner.
        self._say(("ok\r\n" if held_up else "") + self._greeting())
        if self.door_is_open and not locked:
            self._state = "Door"

    def _greeting(self) -> str:
        return greeting(self.version, locked=self._state == "Alarm")

    def _critical_alarm(self, code: int) -> None:
        self.axes.forget_plan()
        self._state = "Alarm"
        self._dead = True
        self._say(f"ALARM:{code}\r\n")
        self._advice_s = self._world.clock.now_s() + RESET_ADVICE_S

    # Time

    def _advance(self) -> None:
        now_s = self._world.clock.now_s()
        if self._advice_s is not None and now_s >= self._advice_s:
            self._advice_s = None
            self._say("[MSG:Reset to continue]\r\n")
        if self._dead:
            return
        if self._state in ("Run", "Jog"):
            self.axes.advance()
            if self.axes.is_moving() and self.axes.at_switch() and self.settings[21]:
                self._critical_alarm(1)
                return
            if not self.axes.planned():
                self._state = "Idle"
        if self._state == "Home":
            self._go_on_homing()
        if self._waits is not None and not self._waits():
            self._waits = None
            if not self._dead:
                self._say("ok\r\n")
        self._read_lines()

    # Bytes and lines

    def _hear(self, byte: int) -> None:
        if byte == 0x18:
            self._reset()
        elif self._dead:
            return
        elif self._state == "Home":
            if byte not in b"?!~" and byte < 0x80:
                self.input.take(byte)
        elif byte == ord("?"):
            self._say(self._report())
        elif byte == ord("!"):
            self._hold()
        elif byte == ord("~"):
            self._resume()
        elif byte == SAFETY_DOOR:
            self._stop_at_door()
        elif byte == 0x85:
            self._cancel_jog()
        elif byte < 0x80:
            self.input.take(byte)
            self._read_lines()

    def _read_lines(self) -> None:
        while self._waits is None and not self._dead and self._state not in ("Home", "Door", "Sleep"):
            line = self.input.next_line()
            if line is None:
                return
            self._answer(line)

    def _answer(self, line: str) -> None:
        try:
            if len(line) > LONGEST_LINE:
                raise GrblError(11)
            text = strip_comments("".join(character for character in line if character.isprintable()))
            if text.startswith("$"):
                self._system(text)
            elif text:
                self._gcode(text)
        except GrblError as error:
            self._say(f"error:{error.code}\r\n")
            return
        if self._waits is None and not self._dead:
            self._say("ok\r\n")
        elif self._dead:
            self._waits = lambda: True  # answered when the reset comes

    # $ commands

    def _system(self, text: str) -> None:
        match text:
            case "$":
                self._say(HELP)
            case "$$" | "$I" | "$#" | "$N":
                self._need_idle()
                self._say(self._listings()[text])
            case "$G":
                self._say(self._listings()[text])
            case "$X":
                if self._state == "Alarm":
                    self._state = "Idle"
                    self._say("[MSG:Caution: Unlocked]\r\n")
            case "$C":
                self._toggle_check()
            case "$SLP":
                self._need_idle()
                self._state = "Sleep"
                self._say("[MSG:Sleeping]\r\n")
            case "$H" | "$HX" | "$HY" | "$HZ":
                self._home(text[2:])
            case _ if text.startswith("$J="):
                self._jog(text[3:])
            case _ if "=" in text:
                self._need_idle()
                self.settings.store(*text[1:].split("=", 1))
            case _:
                raise GrblError(3)

    def _listings(self) -> dict[str, str]:
        modes, place = self._modes, self._reporter.triple(self._offset_mm)
        return {
            "$$": self.settings.listing(),
            "$I": f"[VER:{self.version}:]\r\n[OPT:{self.build_options},{PLANNER_BLOCKS},{RX_BUFFER}]\r\n",
            "$#": f"[G54:0.000,0.000,0.000]\r\n[G92:{place}]\r\n[TLO:0.000]\r\n",
            "$N": "$N0=\r\n$N1=\r\n",
            "$G": f"[GC:{modes.words()}]\r\n",
        }

    def _need_idle(self) -> None:
        if self._state not in ("Idle", "Alarm", "Check"):
            raise GrblError(8)

    def _toggle_check(self) -> None:
        if self._state == "Check":
            self._say("[MSG:Disabled]\r\n")
            self._reset()
        elif self._state == "Idle":
            self._state = "Check"
            self._say("[MSG:Enabled]\r\n")
        else:
            raise GrblError(8)

    # Motion

    def _jog(self, text: str) -> None:
        if self._state not in ("Idle", "Jog"):
            raise GrblError(8)
        order = read_jog(text, modes=self._modes, machine_mm=self.axes.planned_end_mm(), offset_mm=self._offset_mm)
        if self.settings[20] and self.settings.is_beyond_travel(order.machine_mm):
            raise GrblError(15)
        self._plan(order, "Jog")

    def _gcode(self, text: str) -> None:
        if self._state in ("Alarm", "Jog"):
            raise GrblError(9)
        order = read_line(text, modes=self._modes, machine_mm=self.axes.planned_end_mm(), offset_mm=self._offset_mm)
        self._modes = order.modes
        if self._state == "Check":
            return
        if order.kind == "offset":
            self._offset_mm = order.offset_mm
            self._reporter.forget()
        elif order.kind == "dwell":
            dwells = self.axes.dwell(order.dwell_s)
            self._waits = dwells if dwells() else None
        elif order.kind == "move":
            if self.settings[20] and self.settings.is_beyond_travel(order.machine_mm):
                self._critical_alarm(2)
            else:
                self._plan(order, "Run")

    def _plan(self, order: Order, state: str) -> None:
        fastest = self.settings[110]
        feed = min(order.feed_mm_per_min or fastest, fastest)
        if self._state == "Idle":
            self._state = state
        self.axes.add(Block(order.machine_mm, feed / 60))
        if self._state in ("Run", "Jog"):
            self.axes.advance()
        if self.axes.planned() > PLANNER_BLOCKS:
            self._waits = lambda: self.axes.planned() > PLANNER_BLOCKS

    def _hold(self) -> None:
        if self._state == "Jog":
            self._cancel_jog()
        elif self._state == "Run":
            self.axes.halt()
            self._state = "Hold"
            self._hold_ends_s = self._world.clock.now_s() + HOLD_S

    def _stop_at_door(self) -> None:
        if self._state in ("Idle", "Run", "Jog", "Hold"):
            self.axes.halt()
            if self._state == "Jog":
                self.axes.forget_plan()
            self._state = "Door"

    def _resume(self) -> None:
        if self._state == "Hold" or (self._state == "Door" and not self.door_is_open):
            self._state = "Run"
            self.axes.advance()

    def _cancel_jog(self) -> None:
        if self._state == "Jog":
            self.axes.forget_plan()
            self._state = "Idle"

    # Homing

    def _home(self, axis: str) -> None:
        if not self.settings[22]:
            raise GrblError(5)
        if axis and "H" not in self.build_options:
            raise GrblError(3)
        if self._state not in ("Idle", "Alarm"):
            raise GrblError(8)
        self._state = "Home"
        self._waits = lambda: self._state == "Home"
        self._homing = homing_cycle(
            self.axes, clock=self._world.clock, settings=self.settings, faults=self.faults, x_only=bool(axis)
        )

    def _go_on_homing(self) -> None:
        try:
            next(self._homing)
        except StopIteration as end:
            if end.value == 0:
                self._state = "Idle"
                return
            # A homing that failed says ALARM, then ok all the same, and resets itself.
            self._say(f"ALARM:{end.value}\r\nok\r\n")
            self.axes.forget_plan()
            self._begin_again("Alarm")
            self._say(self._greeting())

    # Reports

    def _report(self) -> str:
        state = self._state
        if state in ("Hold", "Door"):
            under_way = self.door_is_open if state == "Door" else self._world.clock.now_s() < self._hold_ends_s
            state = f"{state}:{int(under_way)}"
        return self._reporter.report(
            state,
            machine_mm=self.axes.machine_mm(),
            offset_mm=self._offset_mm,
            feed=self._modes.feed_mm_per_min if self.axes.is_moving() else 0.0,
            at_switch=self.axes.at_switch(),
            room=(PLANNER_BLOCKS - self.axes.planned(), self.input.room()),
        )
