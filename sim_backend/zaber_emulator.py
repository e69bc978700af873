"""A Zaber linear stage with an integrated controller as its serial port sees it, moving the stage of the world.

Written from the Zaber ASCII protocol manual (zaber.com/wiki/ASCII) and from Zaber's published list of warning flags:
one device of address 1 with one axis. It has an encoder, so what moves the carriage is seen.
"""

import threading

from sim_backend.world import World
from sim_backend.zaber_message import ZaberCommand, read_command, write_message

ADDRESS = 1
# Speeds are data values of 1.6384 / (microsteps per second).
SPEED_PER_MICROSTEP_PER_S = 1.6384
# As the manual orders them: the first that is set is the one that every reply shows.
FLAGS_BY_PRIORITY = (
    *("FF", "FN", "FZ", "FH", "FV", "FO", "FD", "FC", "FM", "FQ", "FI", "FA", "FR", "FS", "FB", "FP", "FE", "FT"),
    *("WL", "WV", "WT", "WS", "WM", "WP", "WR", "WH", "NC", "NI", "ND", "NR", "NT", "NU", "NJ", "NB"),
)
CLEARED_BY_MOVING = {"NI", "FS", "WL", "WS", "WM"}
DRIVER_OFF = {"FO", "FD"}


class ZaberRejection(Exception):
    """A command that is answered with RJ and this reason."""


class ZaberEmulator:
    """Implements :class:`sim_backend.wire.Emulator`.

    Parameters
    ----------
    world
        Its stage is axis 1.
    travel_mm
        Where on the world's stage the device has its positions 0 and ``limit.max``.
    microstep_mm
        What one microstep moves; an X-LSM device has 0.000047625 mm.
    velocity_mm_per_s
        The speed it is delivered with (``maxspeed``).

    Attributes
    ----------
    rejects
        Commands by their first word (``move``, ``home``, ``get``, ...), each with the reasons of its next rejections.
    """

    def __init__(
        self, world: World, *, travel_mm: tuple[float, float], microstep_mm: float, velocity_mm_per_s: float
    ) -> None:
        self._world = world
        self._low_mm, high_mm = travel_mm
        self._microstep_mm = microstep_mm
        self._lock = threading.RLock()
        self._settings: dict[str, int] = {
            "comm.address": ADDRESS,
            "comm.alert": 0,
            "deviceid": 50081,
            "limit.max": round((high_mm - self._low_mm) / microstep_mm),
            "limit.min": 0,
            "limit.home.pos": 0,
            "maxspeed": round(velocity_mm_per_s / microstep_mm * SPEED_PER_MICROSTEP_PER_S),
            "resolution": 64,
            "system.access": 1,
            "system.axiscount": 1,
            "system.serial": 12345,
        }
        self._buffer = bytearray()
        self._said = b""
        self.rejects: dict[str, list[str]] = {}
        self._power_up()

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the host and return the replies to every command that is now complete."""
        with self._lock:
            self._advance()
            self._buffer += data
            while b"\n" in self._buffer:
                line, _, rest = bytes(self._buffer).partition(b"\n")
                self._buffer = bytearray(rest)
                command = read_command(line)
                if command is not None and command.device in (0, ADDRESS):
                    self._reply(command)
            return self._speak()

    def poll(self) -> bytes:
        """Return alerts and infos whose time has come."""
        with self._lock:
            self._advance()
            return self._speak()

    def _speak(self) -> bytes:
        said, self._said = self._said, b""
        return said

    # What happens to the machine from outside

    def power_cycle(self) -> None:
        """Switch off and on: the device no longer knows where it is."""
        with self._lock:
            self._power_up()

    def _power_up(self) -> None:
        self._world.stop_motion()
        self._flags = {"WR"}
        self._moving = self._homing = False
        # The count of microsteps begins at zero wherever the carriage is.
        self._zero_mm = self._world.stage_mm()

    def fail(self, flag: str) -> None:
        """Stop with a warning flag: ``FS`` stalled, ``WL`` unexpected limit, ``FO`` driver switched off, and so on."""
        with self._lock:
            self._world.stop_motion()
            self._flags.add(flag)
            self._moving = self._homing = False

    def warn(self, flag: str) -> None:
        """Warn with a flag and go on: ``WS`` stalled and recovered, ``WT`` hot, ``WV`` voltage."""
        with self._lock:
            self._flags.add(flag)

    def push(self, distance_mm: float) -> None:
        """Displace the carriage by hand while it stands; the encoder notices."""
        with self._lock:
            self._world.start_motion(self._world.stage_mm() + distance_mm, velocity_mm_per_s=1e9)
            self._world.clock.sleep_s(1e-6)
            self._world.stop_motion()
            self._flags.add("WM")

    def remark(self, text: str) -> None:
        """Send an info message that nobody asked for."""
        with self._lock:
            self._said += write_message("#", f"{ADDRESS:02d} 0 -- {text}", with_checksum=False)

    # State

    def _advance(self) -> None:
        if not self._moving or self._world.is_moving():
            return
        self._world.stop_motion()
        self._moving = False
        if self._homing:
            self._homing = False
            self._zero_mm = self._low_mm
            self._flags -= {"WR", "WH"}
        if self._settings["comm.alert"]:
            self._said += write_message("!", f"{ADDRESS:02d} 1 IDLE {self._shown_flag()}", with_checksum=True)

    def _shown_flag(self) -> str:
        return next((flag for flag in FLAGS_BY_PRIORITY if flag in self._flags), "--")

    def _position(self) -> int:
        return round((self._world.stage_mm() - self._zero_mm) / self._microstep_mm)

    # Commands

    def _reply(self, command: ZaberCommand) -> None:
        try:
            if command.axis > 1:
                raise ZaberRejection("BADAXIS")
            reasons = self.rejects.get(next(iter(command.words), ""))
            if reasons:
                raise ZaberRejection(reasons.pop(0))
            verdict, data = "OK", self._obey(command.words)
        except ZaberRejection as rejection:
            verdict, data = "RJ", str(rejection)
        identity = "" if command.id == "--" else f" {command.id}"
        state = "BUSY" if self._moving else "IDLE"
        body = f"{ADDRESS:02d} {command.axis}{identity} {verdict} {state} {self._shown_flag()} {data}"
        self._said += write_message("@", body, with_checksum=command.has_checksum)

    def _obey(self, words: tuple[str, ...]) -> str:
        match words:
            case () | ("driver", "enable"):
                self._flags -= DRIVER_OFF if words else set()
            case ("home",):
                self._homing = False
                self._start(self._low_mm)
                self._homing = True
            case ("move", ("abs" | "rel") as how, number):
                target = _integer(number) + (self._position() if how == "rel" else 0)
                self._move_to(target)
            case ("move", ("min" | "max") as end):
                self._move_to(self._settings[f"limit.{end}"])
            case ("move", "vel", number):
                self._move_to(self._settings["limit.max" if _integer(number) > 0 else "limit.min"])
            case ("stop",) | ("estop",):
                self._interrupt()
            case ("get", name):
                return self._get(name)
            case ("set", name, value):
                self._set(name, _integer(value))
            case ("warnings",):
                return self._warnings()
            case ("warnings", "clear"):
                listed = self._warnings()
                self._flags -= CLEARED_BY_MOVING
                return listed
            case ("tools", "echo", *rest):
                return " ".join(rest) or "0"
            case ("renumber",):
                return str(ADDRESS)
            case ("io", "get", "di"):
                return "0 0 0 0"
            case ("system", "reset"):
                self._power_up()
            case _:
                raise ZaberRejection("BADCOMMAND")
        return "0"

    def _warnings(self) -> str:
        flags = [flag for flag in FLAGS_BY_PRIORITY if flag in self._flags]
        return " ".join([f"{len(flags):02d}", *flags])

    def _get(self, name: str) -> str:
        if name == "pos":
            return str(self._position())
        if name == "version":
            return "7.35"
        if name not in self._settings:
            raise ZaberRejection("BADCOMMAND")
        return str(self._settings[name])

    def _set(self, name: str, value: int) -> None:
        if name not in ("maxspeed", "comm.alert", "limit.max", "limit.min"):
            raise ZaberRejection("BADCOMMAND")
        if value < 0 or (name == "maxspeed" and value == 0):
            raise ZaberRejection("BADDATA")
        self._settings[name] = value

    def _move_to(self, position: int) -> None:
        if not self._settings["limit.min"] <= position <= self._settings["limit.max"]:
            raise ZaberRejection("BADDATA")
        self._start(self._zero_mm + position * self._microstep_mm)

    def _start(self, to_mm: float) -> None:
        if self._flags & DRIVER_OFF:
            raise ZaberRejection("DRIVERDISABLED")
        was_moving = self._moving
        self._flags -= CLEARED_BY_MOVING
        if was_moving:
            self._flags.add("NI")  # one movement gave way to another
        velocity_mm_per_s = self._settings["maxspeed"] / SPEED_PER_MICROSTEP_PER_S * self._microstep_mm
        self._world.start_motion(to_mm, velocity_mm_per_s=velocity_mm_per_s)
        self._moving = True

    def _interrupt(self) -> None:
        if self._moving:
            self._flags.add("NI")
        self._world.stop_motion()
        self._moving = self._homing = False


def _integer(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise ZaberRejection("BADDATA") from None
