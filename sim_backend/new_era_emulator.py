"""An emulated New Era pump (NE-1000 syringe pumps, NE-9000 peristaltic pumps): bytes in, bytes out.

Written from the manuals of the maker: NE-9000 (publication 1200-04) pages 40 to 48, NE-1000 (1200-01) pages 33 and 34,
NE-500 (1200-02) page 7. The liquid that it moves is that of :class:`sim_backend.world.World`.

What the manuals leave open is decided for the worse: an alarm swallows ``SAF`` as it swallows any other command, and
``STP`` on a pump that stands is answered with ``?NA``.
"""

import re
import threading

from sim_backend.new_era_memory import ML_PER_S_PER_UNIT, ML_PER_UNIT, Memory, Phase, four_digits, number_in
from sim_backend.new_era_motor import LAST_PHASE, WORLD_DIRECTION, Motor
from sim_backend.new_era_packets import INTER_BYTE_S, PacketReader, pack_basic, pack_safe
from sim_backend.world import World

# Up to this inside diameter volumes are in microlitres, above it in millilitres (NE-500 quick start).
MICROLITRES_UP_TO_MM = 14.00
COMMAND = re.compile(r"(\*?)(\d{0,2})([A-Z]{0,3})(.*)", re.ASCII)


class NewEraEmulator:
    """A pump of the New Era family that moves the liquid of ``world``.

    Parameters
    ----------
    max_rate_ml_per_min
        A faster rate is answered with ``?OOR``.
    memory
        What an earlier owner left in the pump, for example Safe mode or a program of several phases.
    world_s_per_host_s
        How many of the world's seconds pass in one of the host's. The host's silence is measured in the host's own
        time: a world that runs faster does not make the host any quicker.

    Attributes
    ----------
    deaf_to, mute_after
        Commands (``RUN``, ``STP``, ...) of which the next one is lost on its way in, or carried out without a reply.
    reset_before
        Commands of which the next one finds the pump just back from a power failure.
    answers
        Commands with their parameters (``SAF5``, ``RUN``, ``DIS``), each with what the pump says to the next ones and
        does not do.
    rings_for_ever
        The letter of an alarm whose cause stays: it rings again as soon as it is acknowledged.
    rate_step
        Rates are rounded to multiples of this number, in the units they were sent in; 0 keeps them as they are.
    """

    def __init__(
        self,
        world: World,
        *,
        max_rate_ml_per_min: float = 2000.0,
        memory: Memory | None = None,
        world_s_per_host_s: float = 1.0,
    ) -> None:
        self.memory = memory or Memory()
        self.version = "NE9000V3.928"
        self.deaf_to: list[str] = []
        self.mute_after: list[str] = []
        self.reset_before: list[str] = []
        self.answers: dict[str, list[str]] = {}
        self.rings_for_ever = ""
        self.rate_step = 0.0
        self.commands: list[str] = []
        self._world = world
        self._max_rate_ml_per_s = max_rate_ml_per_min / 60
        self._packets = PacketReader(world.clock, inter_byte_s=INTER_BYTE_S * world_s_per_host_s)
        self._lock = threading.RLock()
        self._motor = Motor(world, self.memory, world_s_per_host_s=world_s_per_host_s)
        self._selected = 1  # the phase that commands talk about

    # The wire

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the host and return the replies."""
        with self._lock:
            self._motor.advance()
            return b"".join(self._answer(packet.data, safe=packet.safe) for packet in self._packets.feed(data))

    def poll(self) -> bytes:
        """Return the alarm that Safe mode announces of its own accord; announcing it does not clear it."""
        with self._lock:
            self._motor.advance()
            if not self._motor.alarm_is_news:
                return b""
            self._motor.alarm_is_news = False
            return pack_safe(self._reply("")) if self.memory.safe_s else b""

    def _answer(self, data: bytes | None, *, safe: bool) -> bytes:
        if self.memory.safe_s and not safe:
            return b""
        if data is None:
            return self._pack(self._reply("?COM"))
        text = re.sub(r"[^\x21-\x7e]", "", data.decode("latin-1")).upper()
        parts = COMMAND.fullmatch(text)
        if parts is None:
            return self._pack(self._reply("?"))
        system, address, name, argument = parts.groups()
        if not system and int(address or 0) != self.memory.address:
            return b""
        if name in self.deaf_to:
            self.deaf_to.remove(name)
            return b""
        if name in self.reset_before:
            self.reset_before.remove(name)
            self.power_cycle()
        self.commands.append(name + argument)
        if safe:
            self._motor.heard()
        if self._motor.alarm:
            reply = self._reply("")
            self._motor.acknowledge()
        elif forced := self.answers.get(name + argument):
            reply = self._reply(forced.pop(0))
        else:
            reply = self._reply(self._execute(name, argument))
        if self.rings_for_ever:
            self.ring(self.rings_for_ever)
        if name in self.mute_after:
            self.mute_after.remove(name)
            return b""
        return self._pack(reply)

    def _reply(self, data: str) -> str:
        status = f"A?{self._motor.alarm}" if self._motor.alarm else self._motor.prompt
        return f"{self.memory.address:02d}{status}{data}"

    def _pack(self, reply: str) -> bytes:
        return pack_safe(reply) if self.memory.safe_s else pack_basic(reply)

    # What can happen to a pump

    def break_dead_man(self) -> None:
        """Let the time-out of Safe mode never come: a fault inside the pump."""
        with self._lock:
            self._motor.dead_man_works = False
            self._motor.turn_on()

    def stall(self) -> None:
        """Block the motor: a pump that turns stops with the alarm ``A?S``."""
        with self._lock:
            self._motor.advance()
            if self._motor.turning():
                self.ring("S")

    def ring(self, kind: str) -> None:
        """Stop with an alarm: ``S`` stalled, ``E`` or ``O`` an error in the pumping program."""
        with self._lock:
            self._motor.halt("S")
            self._motor.raise_alarm(kind)

    def power_cycle(self) -> None:
        """Take the power away and bring it back; only :class:`Memory` survives."""
        with self._lock:
            self._motor.advance()
            restart = self.memory.power_fail_restart and self._motor.turning()
            self._motor.halt("S")
            self._motor.power_up()
            self._packets.clear()
            self._selected = 1
            self._motor.raise_alarm("R")
            if restart:
                self._motor.begin(1)

    def press_stop_key(self) -> None:
        """Press Stop on the pump's own keypad: it pauses."""
        with self._lock:
            self._motor.advance()
            if self._motor.turning():
                self._motor.halt("P")

    # Commands

    def _execute(self, name: str, argument: str) -> str:
        phase = self.memory.phase(self._selected)
        match name:
            case "":
                return "?" if argument else ""
            case "DIA":
                return self._diameter(argument)
            case "RAT":
                return self._rate(phase, argument)
            case "VOL":
                return self._volume(phase, argument)
            case "DIR":
                return self._direction(phase, argument)
            case "FUN":
                return self._function(phase, argument)
            case "PHN":
                return self._select_phase(argument)
            case "RUN" | "STP":
                return self._run(argument) if name == "RUN" else self._stop(argument)
            case "DIS" | "CLD":
                return self._dispensed(argument) if name == "DIS" else self._clear(argument)
            case "PF":
                return self._power_fail(argument)
            case "SAF":
                return self._safe_mode(argument)
            case "VER":
                return self.version if not argument else "?NA"
        return "?"

    def _diameter(self, argument: str) -> str:
        if not argument:
            return four_digits(self.memory.diameter_mm)
        value = number_in(argument)
        if self._motor.prompt != "S":
            return "?NA"
        if value is None or not 0.1 <= value <= 80.0:
            return "?OOR"
        self.memory.diameter_mm = value
        self.memory.volume_units = "UL" if value <= MICROLITRES_UP_TO_MM else "ML"
        self._motor.dispensed_ml = {"INF": 0.0, "WDR": 0.0}
        return ""

    def _rate(self, phase: Phase, argument: str) -> str:
        if not argument:
            return four_digits(phase.rate) + phase.rate_units
        units = argument[-2:] if argument[-2:].isalpha() else phase.rate_units
        value = number_in(argument.removesuffix(units))
        if self._motor.turning() and argument.endswith(units):
            return "?NA"  # units cannot change while pumping
        if units not in ML_PER_S_PER_UNIT or value is None:
            return "?"
        if value * ML_PER_S_PER_UNIT[units] > self._max_rate_ml_per_s * (1 + 1e-9):
            return "?OOR"
        phase.rate = round(value / self.rate_step) * self.rate_step if self.rate_step else value
        phase.rate_units = units
        self._motor.turn_on()
        return ""

    def _volume(self, phase: Phase, argument: str) -> str:
        if not argument:
            return four_digits(phase.volume) + self.memory.volume_units
        if self._motor.turning():
            return "?NA"
        if argument in ML_PER_UNIT:
            self.memory.volume_units = argument
            return ""
        value = number_in(argument)
        if value is None:
            return "?OOR"
        phase.volume = value
        return ""

    def _direction(self, phase: Phase, argument: str) -> str:
        if not argument:
            return phase.direction
        if self._motor.turning() and phase.volume:
            return "?NA"  # only a pump without a volume may be turned round (NE-500 page 7)
        if argument == "REV":
            argument = "WDR" if phase.direction == "INF" else "INF"
        if argument not in WORLD_DIRECTION:
            return "?"
        phase.direction = argument
        self._motor.turn_on()
        return ""

    def _function(self, phase: Phase, argument: str) -> str:
        if not argument:
            return phase.function
        if self._motor.prompt != "S":
            return "?NA"
        if argument not in ("RAT", "STP"):
            return "?"
        phase.function = argument
        return ""

    def _select_phase(self, argument: str) -> str:
        if not argument:
            return f"{self._selected:02d}"
        if self._motor.prompt != "S":
            return "?NA"
        if not argument.isdigit() or not 1 <= int(argument) <= LAST_PHASE:
            return "?OOR"
        self._selected = int(argument)
        return ""

    def _run(self, argument: str) -> str:
        if self._motor.turning():
            return "?NA"
        if argument and not (argument.isdigit() and 1 <= int(argument) <= LAST_PHASE):
            return "?OOR"
        number = self._motor.number if self._motor.prompt == "P" else int(argument or 1)
        if self.memory.phase(number).rate <= 0:
            return "?OOR"
        if self._motor.prompt == "P":
            self._motor.turn()
        else:
            self._motor.begin(number)
        return ""

    def _stop(self, argument: str) -> str:
        if argument:
            return "?"
        if self._motor.prompt == "S":
            return "?NA"
        self._motor.halt("P" if self._motor.turning() else "S")
        return ""

    def _dispensed(self, argument: str) -> str:
        if argument:
            return "?NA"
        per_ml = 1 / ML_PER_UNIT[self.memory.volume_units]
        infused, withdrawn = (four_digits(self._motor.dispensed_ml[name] * per_ml) for name in ("INF", "WDR"))
        return f"I{infused}W{withdrawn}{self.memory.volume_units}"

    def _clear(self, argument: str) -> str:
        if argument not in self._motor.dispensed_ml:
            return "?"
        if self._motor.turning():
            return "?NA"
        self._motor.dispensed_ml[argument] = 0.0
        return ""

    def _power_fail(self, argument: str) -> str:
        if argument in ("0", "1"):
            self.memory.power_fail_restart = argument == "1"
            return ""
        return "?" if argument else str(int(self.memory.power_fail_restart))

    def _safe_mode(self, argument: str) -> str:
        if not argument:
            return str(self.memory.safe_s)
        if not argument.isdigit() or not 0 <= int(argument) <= 255:
            return "?OOR"
        self.memory.safe_s = int(argument)
        self._motor.heard()
        return ""
