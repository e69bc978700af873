"""The motor of an emulated New Era pump: phases, volumes, alarms and the dead-man timer of Safe mode."""

import math

from drivers.protocols import FlowDirection
from sim_backend.new_era_memory import ML_PER_S_PER_UNIT, ML_PER_UNIT, Memory
from sim_backend.world import World

WORLD_DIRECTION: dict[str, FlowDirection] = {"INF": "fill", "WDR": "drain"}
PROMPT = {"INF": "I", "WDR": "W"}
LAST_PHASE = 41


class Motor:
    """Turns the liquid of ``world`` through the phases of ``memory``.

    Attributes
    ----------
    prompt
        ``S`` stopped, ``P`` paused, ``I`` infusing, ``W`` withdrawing.
    dispensed_ml
        What the head has turned in each direction: no liquid needs to have moved.
    alarm, alarm_is_news
        The letter of the alarm that nobody has acknowledged yet, and whether Safe mode has still to announce it.
    dead_man_works
        False to let the time-out of Safe mode never come.
    """

    def __init__(self, world: World, memory: Memory, *, world_s_per_host_s: float = 1.0) -> None:
        self._world = world
        self._memory = memory
        self._world_s_per_host_s = world_s_per_host_s
        self.alarm = ""
        self.alarm_is_news = False
        self.dead_man_works = True
        self.power_up()

    def power_up(self) -> None:
        """Forget everything but the memory."""
        self.prompt = "S"
        self.number = 1
        self.dispensed_ml = {"INF": 0.0, "WDR": 0.0}
        self._left_ml = 0.0
        self._counted_ml = 0.0
        # The timer starts with the first valid packet, not with the power (NE-1000 page 34).
        self._heard_s: float | None = None

    def turning(self) -> bool:
        """Tell whether the head turns."""
        return self.prompt in PROMPT.values()

    def heard(self) -> None:
        """Start the Safe-mode time-out anew: a valid packet came, which does not hold up the head."""
        self._heard_s = self._world.clock.now_s()
        if self.turning() and not self._world.extend_flow(
            volume_ml=self._counted_ml + self._left_ml, until_s=self._silent_at_s()
        ):
            self.turn_on()

    def begin(self, number: int) -> None:
        """Run phase ``number`` from its beginning; a phase that stops ends the program."""
        phase = self._memory.phase(number)
        if phase.function != "RAT":
            self.prompt = "S"
            return
        self.number = number
        self._left_ml = phase.volume * ML_PER_UNIT[self._memory.volume_units] if phase.volume else math.inf
        self.turn()

    def turn(self) -> None:
        """Turn for what is left of the phase, but no longer than the Safe-mode time-out allows."""
        phase = self._memory.phase(self.number)
        self.prompt = PROMPT[phase.direction]
        self._counted_ml = 0.0
        self._world.start_flow(
            WORLD_DIRECTION[phase.direction],
            rate_ml_per_s=phase.rate * ML_PER_S_PER_UNIT[phase.rate_units],
            volume_ml=self._left_ml,
            max_run_s=max(0.0, self._silent_at_s() - self._world.clock.now_s()),
        )

    def turn_on(self) -> None:
        """Turn on as the phase says now, if the head turns at all."""
        if self.turning():
            prompt = self.prompt
            self.halt(prompt)
            self.turn()

    def halt(self, prompt: str) -> None:
        """Stop the head; ``prompt`` is what the pump says from now on."""
        if self.turning():
            self._world.stop_flow()
            self._count()
        self.prompt = prompt

    def acknowledge(self) -> None:
        """The alarm was sent in a reply."""
        self.alarm, self.alarm_is_news = "", False

    def raise_alarm(self, kind: str) -> None:
        """Ring until somebody acknowledges."""
        self.alarm, self.alarm_is_news = kind, True

    def advance(self) -> None:
        """Bring the pump to the present: volumes that are moved, phases that are over, silence that lasted too long."""
        silent = self._world.clock.now_s() >= self._silent_at_s()
        self._count()
        if self.turning() and self._left_ml <= 1e-9:
            self._world.stop_flow()  # rounding may have left the world a trillionth of a second of it
            if silent or self.number == LAST_PHASE:
                self.prompt = "S"
            else:
                self.begin(self.number + 1)
        if silent:
            self.halt("S")
            self._heard_s = None
            self.raise_alarm("T")

    def _silent_at_s(self) -> float:
        if self._heard_s is None or not self._memory.safe_s or not self.dead_man_works:
            return math.inf
        return self._heard_s + self._memory.safe_s * self._world_s_per_host_s

    def _count(self) -> None:
        if self.turning():
            more_ml = self._world.moved_ml() - self._counted_ml
            self.dispensed_ml[self._direction()] += more_ml
            self._left_ml -= more_ml
            self._counted_ml += more_ml

    def _direction(self) -> str:
        return "INF" if self.prompt == "I" else "WDR"
