"""The mechanics behind the emulated GRBL: three axes, of which X carries the display of the world.

GRBL counts steps; it never sees where the carriage is. Here the count follows the world, so that whatever moves the
stage is seen, except where a fault separates the two: a carriage that stalls or is pushed keeps its count.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from sim_backend.world import World

Place = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Block:
    """One straight move in the planner: machine coordinates and speed along the path."""

    machine_mm: Place
    velocity_mm_per_s: float


class GrblAxes:
    """X is on the world's stage between ``switch_mm`` (the homing switch) and ``far_mm`` (the other end stop)."""

    def __init__(self, world: World, *, switch_mm: float, far_mm: float) -> None:
        self._world = world
        self.switch_mm = switch_mm
        self.far_mm = far_mm
        self.toward_switch = 1.0  # the sign of the machine's X axis toward the switch
        self._origin_mm = world.stage_mm()
        self._y_mm = self._z_mm = 0.0
        self._queue: deque[Block] = deque()
        self._current: Block | None = None
        self._ends_s = 0.0

    # Where it is

    def machine_mm(self) -> Place:
        """Return what GRBL counts."""
        return self._machine_x_mm(self._world.stage_mm()), self._y_mm, self._z_mm

    def _machine_x_mm(self, world_mm: float) -> float:
        return -self.toward_switch * (world_mm - self._origin_mm)

    def _world_mm(self, machine_x_mm: float) -> float:
        return self._origin_mm - machine_x_mm * self.toward_switch

    def count_from_here(self, machine_x_mm: float) -> None:
        """Call the present place ``machine_x_mm``, as power-up and homing do."""
        self._origin_mm = self._world.stage_mm() + machine_x_mm * self.toward_switch

    def push(self, distance_mm: float) -> None:
        """Displace the carriage without a step being counted: a hand, a stall, a slipping belt."""
        self._world.stop_motion()
        self._origin_mm += distance_mm
        self._world.start_motion(self._world.stage_mm() + distance_mm, velocity_mm_per_s=1e9)
        self._world.clock.sleep_s(1e-6)
        self._world.stop_motion()

    def at_switch(self) -> bool:
        """Tell whether the carriage presses the homing switch."""
        return self._world.stage_mm() <= self.switch_mm

    # Moving

    def planned(self) -> int:
        """Return how many blocks wait or run."""
        return len(self._queue) + (self._current is not None)

    def planned_end_mm(self) -> Place:
        """Return where the machine will stand when everything planned is done."""
        last = self._queue[-1] if self._queue else self._current
        return last.machine_mm if last else self.machine_mm()

    def is_moving(self) -> bool:
        """Tell whether a block is being executed."""
        return self._current is not None

    def add(self, block: Block) -> None:
        """Append a block to the plan."""
        self._queue.append(block)

    def advance(self) -> None:
        """Finish what is finished by now and begin what comes next."""
        while True:
            if self._current is not None:
                if self._world.clock.now_s() < self._ends_s or self._world.is_moving():
                    return
                self._finish(self._current)
            if not self._queue:
                return
            self._begin(self._queue.popleft())

    def dwell(self, duration_s: float) -> Callable[[], bool]:
        """Return what tells whether to wait on: until everything planned is done, and then for ``duration_s``."""
        ends_s: list[float] = []

        def waits() -> bool:
            if self.planned():
                return True
            if not ends_s:
                ends_s.append(self._world.clock.now_s() + duration_s)
            return self._world.clock.now_s() < ends_s[0]

        return waits

    def halt(self) -> None:
        """Stand still; the rest of the move under way goes back to the head of the plan."""
        self._world.stop_motion()
        if self._current is not None:
            self._queue.appendleft(self._current)
            self._current = None

    def forget_plan(self) -> None:
        """Stand still and drop everything planned."""
        self.halt()
        self._queue.clear()

    def drive_to_world_mm(self, to_mm: float, *, velocity_mm_per_s: float) -> None:
        """Move X without planning, as homing does."""
        self._world.start_motion(to_mm, velocity_mm_per_s=velocity_mm_per_s)

    def is_driving(self) -> bool:
        """Tell whether a drive of :meth:`drive_to_world_mm` is under way."""
        return self._world.is_moving()

    def _begin(self, block: Block) -> None:
        here_mm = self.machine_mm()
        distance_mm = sum((b - a) ** 2 for a, b in zip(here_mm, block.machine_mm, strict=True)) ** 0.5
        duration_s = distance_mm / block.velocity_mm_per_s
        self._current = block
        along_x_mm = abs(block.machine_mm[0] - here_mm[0])
        if along_x_mm > 0:
            to_mm = min(max(self._world_mm(block.machine_mm[0]), self.switch_mm), self.far_mm)
            self._world.start_motion(to_mm, velocity_mm_per_s=along_x_mm / duration_s)
        self._ends_s = self._world.clock.now_s() + duration_s

    def _finish(self, block: Block) -> None:
        self._world.stop_motion()
        self._current = None
        _, self._y_mm, self._z_mm = block.machine_mm
        # At an end stop the motor goes on and the carriage does not: the count says that it arrived.
        self.count_from_here(block.machine_mm[0])
