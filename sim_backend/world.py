"""The one world that all simulated devices share: liquid, the place of the display, and what it shows.

Nothing here runs in the background. A pump that was started and a stage that was set in motion are laws over time; every
question first brings the world up to the present of its clock. The simulated devices and the emulators of real ones
therefore agree about the tank, whoever asks and whenever.
"""

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from drivers.protocols import Clock, FlowDirection, Frame
from sim_backend.disturbance import QUIET, Disturbance
from sim_backend.frame_equality import same_frame
from sim_backend.held_sheet import HeldSheet
from sim_backend.liquid_faults import LiquidFaults
from sim_backend.unrest import Unrest

# Photos know a dry tank and a filled one. The last per cent of the volume raises the level by less than the
# meniscus is high, so that rounding in a pump's volume does not keep the object dry.
WET_FRACTION = 0.99
# An exposure looks back at what was shown while its shutter was open.
FRAMES_KEPT = 64


@dataclass(frozen=True, slots=True)
class TankSize:
    """The tank of a scene: what it can hold, and the volume at which the object's display side is immersed."""

    free_volume_ml: float
    fill_ml: float


@dataclass(frozen=True, slots=True)
class Flow:
    """A pump that was started: it turns until its volume is moved or its longest run time is over."""

    direction: FlowDirection
    rate_ml_per_s: float
    started_s: float
    runs_s: float


@dataclass(frozen=True, slots=True)
class Motion:
    """A stage under way from one place to another at constant speed."""

    from_mm: float
    to_mm: float
    velocity_mm_per_s: float
    started_s: float

    def position_mm(self, now_s: float) -> float:
        """Return where the stage is at ``now_s``."""
        distance_mm = self.to_mm - self.from_mm
        travelled_mm = self.velocity_mm_per_s * (now_s - self.started_s)
        if travelled_mm >= abs(distance_mm):
            return self.to_mm  # exactly: from + (to - from) may differ from to in its last bit
        return self.from_mm + (travelled_mm if distance_mm > 0 else -travelled_mm)


@dataclass(frozen=True, slots=True)
class WorldState:
    """What lasts while nobody looks, as it was at ``at_s`` of the world's clock: liquid, stage and object.

    ``overflow_ml`` is what ran over the tank's rim, ``turned_ml`` what the pump's head has turned since its last start. A
    ``flow`` or ``motion`` under way is a law over time: it goes on whether or not a program still runs.
    """

    tank_ml: float = 0.0
    reservoir_ml: float = 0.0
    overflow_ml: float = 0.0
    stage_mm: float = 0.0
    stage_homed: bool = False
    object_present: bool = True
    turned_ml: float = 0.0
    flow: Flow | None = None
    motion: Motion | None = None
    at_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What the camera sees at one moment.

    ``disturbed``: the stage moved, the pump ran, or the display changed while the shutter was open. ``held`` is what a hand holds
    before everything else.
    """

    frame: Frame
    frame_id: int | None
    stage_position_mm: float
    wet: bool
    object_present: bool
    disturbed: bool
    disturbance: Disturbance = QUIET
    held: HeldSheet | None = None


class World:
    """Liquid, stage, display and object at the present of ``clock``; every method may be called from any thread.

    ``on_change`` hears the new state whenever somebody did something to liquid, stage or object. ``unrest`` is where tests
    push and shake things. ``light_delay_s`` passes from a display's command to its light.
    """

    def __init__(
        self,
        *,
        clock: Clock,
        tank: TankSize,
        dark_frame: Frame,
        state: WorldState,
        on_change: Callable[[WorldState], None] = lambda state: None,  # noqa: ARG005
        light_delay_s: float = 0.0,
    ) -> None:
        self.clock = clock
        self.light_delay_s = light_delay_s
        self.tank = tank
        self.disturbed_photos = 0
        self.unrest = Unrest()
        self._dark_frame = dark_frame
        self._held: HeldSheet | None = None
        self._state = state
        self._on_change = on_change
        self._shown: deque[tuple[float, Frame, int | None]] = deque([(-math.inf, dark_frame, None)], FRAMES_KEPT)
        self.faults = LiquidFaults()
        self._siphoned_s = clock.now_s()
        self._lock = threading.RLock()

    # Liquid

    def start_flow(self, direction: FlowDirection, *, rate_ml_per_s: float, volume_ml: float, max_run_s: float) -> None:
        """Begin to pump; a flow that is under way is replaced."""
        with self._lock:
            self._advance()
            runs_s = min(volume_ml / rate_ml_per_s, max_run_s)
            self._change(flow=Flow(direction, rate_ml_per_s, self.clock.now_s(), runs_s), turned_ml=0.0)

    def extend_flow(self, *, volume_ml: float, until_s: float) -> bool:
        """Let the pump turn on without a pause, to another volume since its start and time; False where it stands already."""
        with self._lock:
            flow = self._state.flow
            if flow is None:
                return False
            runs_s = min(volume_ml / flow.rate_ml_per_s, until_s - flow.started_s)
            self._state = replace(self._state, flow=replace(flow, runs_s=runs_s))
            self._advance()
            self._change()
            return True

    def stop_flow(self) -> None:
        """Stop the pump where it is; harmless when it stands."""
        with self._lock:
            self._advance()
            if not self.faults.welded:
                self._change(flow=None)

    def pour_by_hand(self, to_ml: float) -> None:
        """Let a person bring the tank to ``to_ml`` from the reservoir, or back into it."""
        with self._lock:
            self._advance()
            volume_ml = to_ml - self._state.tank_ml
            self._transfer("fill" if volume_ml > 0 else "drain", abs(volume_ml))
            self.unrest.liquid_moved(self.clock.now_s())
            self._change()

    def flow_direction(self) -> FlowDirection | None:
        """Return which way the pump turns, or None while it stands."""
        with self._lock:
            self._advance()
            return self._state.flow.direction if self._state.flow else None

    def moved_ml(self) -> float:
        """Return what the pump counts since its last start: turns of its head, not liquid."""
        with self._lock:
            self._advance()
            return self._state.turned_ml

    def _change(self, **changes: Any) -> None:
        """Take over what somebody did, and tell it to whom it concerns."""
        self._state = replace(self._state, at_s=self.clock.now_s(), **changes)
        self._on_change(self._state)

    def _advance(self) -> None:
        self._siphon()
        flow = self._state.flow
        if flow is None:
            return
        elapsed_s = self.clock.now_s() - flow.started_s
        runs_s = math.inf if self.faults.welded else flow.runs_s
        turned_ml, ended = flow.rate_ml_per_s * min(elapsed_s, runs_s), elapsed_s >= runs_s
        if turned_ml == self._state.turned_ml and elapsed_s > 0 and not ended:
            return  # asked again at the same moment, as a look at the pump does several times
        moved = self._moved(flow.direction, self.faults.pump_factor * (turned_ml - self._state.turned_ml))
        self.unrest.liquid_moved(flow.started_s + min(elapsed_s, runs_s))
        self._state = replace(self._state, turned_ml=turned_ml, flow=None if ended else flow, **moved)

    def _siphon(self) -> None:
        rate_ml_per_s, since_s = self.faults.siphon_ml_per_s, self._siphoned_s
        self._siphoned_s = self.clock.now_s()
        if rate_ml_per_s:
            direction: FlowDirection = "fill" if rate_ml_per_s > 0 else "drain"
            self._transfer(direction, abs(rate_ml_per_s) * (self._siphoned_s - since_s))

    def _transfer(self, direction: FlowDirection, volume_ml: float) -> None:
        self._state = replace(self._state, **self._moved(direction, volume_ml))

    def _moved(self, direction: FlowDirection, volume_ml: float) -> dict[str, Any]:
        """Return what the vessels hold after so much has flowed, as far as there is any."""
        state = self._state
        if direction == "fill":
            volume_ml = min(volume_ml, state.reservoir_ml)
            level_ml = state.tank_ml + volume_ml
            over_ml = max(0.0, level_ml - self.tank.free_volume_ml)
            return {
                "tank_ml": level_ml - over_ml,
                "reservoir_ml": state.reservoir_ml - volume_ml,
                "overflow_ml": state.overflow_ml + over_ml,
            }
        volume_ml = min(volume_ml, state.tank_ml)
        return {"tank_ml": state.tank_ml - volume_ml, "reservoir_ml": state.reservoir_ml + volume_ml}

    # The stage

    def start_motion(self, to_mm: float, *, velocity_mm_per_s: float) -> None:
        """Set the stage in motion from where it is now."""
        with self._lock:
            self._change(motion=Motion(self.stage_mm(), to_mm, velocity_mm_per_s, self.clock.now_s()))

    def stop_motion(self) -> None:
        """Stop the stage where it is; harmless when it stands."""
        with self._lock:
            self._change(stage_mm=self.stage_mm(), motion=None)

    def stage_mm(self) -> float:
        """Return where the stage is now."""
        with self._lock:
            motion = self._state.motion
            return motion.position_mm(self.clock.now_s()) if motion else self._state.stage_mm

    def is_moving(self) -> bool:
        """Tell whether the stage is still under way."""
        with self._lock:
            motion = self._state.motion
            return motion is not None and self.stage_mm() != motion.to_mm

    def set_homed(self, homed: bool) -> None:
        """Remember whether the stage knows where it is."""
        with self._lock:
            self._change(stage_homed=homed)

    # What is shown and seen

    def show(self, frame: Frame, *, frame_id: int | None, commanded_s: float | None = None) -> None:
        """Put a frame on the glass: at once, or ``light_delay_s`` after it was commanded."""
        with self._lock:
            lit_s = self.clock.now_s()
            if commanded_s is not None:
                lit_s = max(lit_s, commanded_s + self.light_delay_s)
            self._shown.append((max(lit_s, self._shown[-1][0]), frame, frame_id))

    def show_nothing(self) -> None:
        """Let the glass go dark."""
        self.show(self._dark_frame, frame_id=None)

    def place_object(self, present: bool) -> None:
        """Put the object in its holder, or take it out."""
        with self._lock:
            self._change(object_present=present)

    def hold(self, sheet: HeldSheet | None) -> None:
        """Hold a sheet before the camera, or take it away."""
        with self._lock:
            self._held = sheet

    def is_wet(self) -> bool:
        """Tell whether the display side of the object is immersed."""
        with self._lock:
            self._advance()
            return self._state.tank_ml >= WET_FRACTION * self.tank.fill_ml

    def shown(self) -> Frame:
        """Return what is on the glass."""
        with self._lock:
            return self._lit()[0]

    def _lit(self) -> tuple[Frame, int | None]:
        now_s = self.clock.now_s()
        lit = ((frame, frame_id) for lit_s, frame, frame_id in reversed(self._shown) if lit_s <= now_s)
        return next(lit, self._shown[0][1:])

    def shown_between(self, first_s: float, last_s: float) -> tuple[tuple[float, float, Frame], ...]:
        """Return what was on the glass in a while that is over: from when, until when, and the frame."""
        with self._lock:
            starts_s = [lit_s for lit_s, _, _ in self._shown]
            frames = [frame for _, frame, _ in self._shown]
        ends_s = [*starts_s[1:], math.inf]
        seen = [
            (max(start_s, first_s), min(end_s, last_s), frame)
            for start_s, end_s, frame in zip(starts_s, ends_s, frames, strict=True)
            if start_s <= last_s and end_s > first_s
        ]
        return tuple(seen)

    def look(self, *, opened_on: Frame | None = None) -> Sight:
        """Return what a camera sees now, and count the look if something moved meanwhile.

        ``opened_on`` is what was on the glass when its shutter opened.
        """
        with self._lock:
            frame, frame_id = self._lit()
            changed = opened_on is not None and not same_frame(opened_on, frame)
            disturbed = changed or self.is_moving() or self.flow_direction() is not None
            self.disturbed_photos += disturbed
            state = self._state
            wet, unrest = self.is_wet(), self.unrest.at(self.clock.now_s())
            return Sight(frame, frame_id, self.stage_mm(), wet, state.object_present, disturbed, unrest, self._held)

    def state(self) -> WorldState:
        """Return liquid, stage and object as they are now."""
        with self._lock:
            self._advance()
            return replace(self._state, stage_mm=self.stage_mm(), at_s=self.clock.now_s())


def wait_until(clock: Clock, done: Callable[[], bool], *, timeout_s: float, poll_s: float = 0.05) -> bool:
    """Sleep on ``clock`` in small steps until ``done()``; return False when ``timeout_s`` passed first."""
    deadline_s = clock.now_s() + timeout_s
    while not done():
        remaining_s = deadline_s - clock.now_s()
        if remaining_s <= 0:
            return False
        clock.sleep_s(min(poll_s, remaining_s))
    return True
