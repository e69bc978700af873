"""The steps of a capture, as data: what each is, how a person reads it, and how long it takes.

A plan is a tuple of these (:mod:`rig.planning.plan`); :mod:`rig.capturing.sequencer` runs them.
"""

from dataclasses import dataclass
from typing import Literal

from recon.sessions.manifest import Condition
from rig.config import RigConfig

Position = Literal[0, 1]
SetPlace = tuple[Position, Condition]
PhotoKey = tuple[str, str, int]  # set, sweep, index, as in the journal
Request = Literal["insert_object", "remove_object", "fill_tank", "drain_tank"]


@dataclass(frozen=True, slots=True)
class HomeStage:
    """Find the stage's reference, so that positions can be trusted."""


@dataclass(frozen=True, slots=True)
class MoveStage:
    """Carry the display to position 0 or 1."""

    position: Position
    position_mm: float


@dataclass(frozen=True, slots=True)
class FillTank:
    """Pump ``volume_ml`` into the tank, which then holds ``to_ml``."""

    volume_ml: float
    to_ml: float
    max_run_s: float


@dataclass(frozen=True, slots=True)
class DrainTank:
    """Pump ``volume_ml`` out of the tank, which then holds ``to_ml``."""

    volume_ml: float
    to_ml: float
    max_run_s: float


@dataclass(frozen=True, slots=True)
class WaitUntilStill:
    """Let ripples or vibrations die down."""

    duration_s: float
    reason: str


@dataclass(frozen=True, slots=True)
class AskOperator:
    """Ask a person to do something with the object or the tank, and wait for the answer."""

    request: Request
    text: str


@dataclass(frozen=True, slots=True)
class StartSweep:
    """The next ``count`` photos belong to one sweep."""

    set_name: str
    axis: str
    count: int


@dataclass(frozen=True, slots=True)
class TakePhoto:
    """Show one frame and photograph it. ``place_px`` is the stripe's centre; None where it shows no single stripe."""

    set_name: str
    sweep: str
    index: int
    place_px: float | None
    frame_id: int

    @property
    def key(self) -> PhotoKey:
        """How the journal names this photo."""
        return (self.set_name, self.sweep, self.index)


@dataclass(frozen=True, slots=True)
class ChooseExposure:
    """Choose the camera's exposure time with photos of the white display, before the first photo that is kept."""

    white: TakePhoto


@dataclass(frozen=True, slots=True)
class FindSweptRange:
    """Read from the photos of a set's scan which part of the display is seen, and plan the set's sweeps again."""

    set_name: str


@dataclass(frozen=True, slots=True)
class JudgeSet:
    """Wait until the sweeps of a set are decoded; bad ones are void, and planned again."""

    set_name: str


Step = (
    HomeStage
    | MoveStage
    | FillTank
    | DrainTank
    | WaitUntilStill
    | AskOperator
    | StartSweep
    | TakePhoto
    | ChooseExposure
    | FindSweptRange
    | JudgeSet
)


def step_duration_s(step: Step, config: RigConfig) -> float:
    """Estimate how long a step takes; a person's part counts as nothing."""
    if isinstance(step, TakePhoto):
        return config.timing.settle_s + config.timing.photo_s
    if isinstance(step, FillTank | DrainTank):
        rate_ml_per_min = config.tank.pump_rate_ml_per_min if config.tank else 1.0
        return step.volume_ml / rate_ml_per_min * 60
    if isinstance(step, HomeStage | MoveStage):
        # The way is not known beforehand; the whole travel bounds it.
        return (config.stage.travel_mm[1] - config.stage.travel_mm[0]) / config.stage.velocity_mm_per_s
    return step.duration_s if isinstance(step, WaitUntilStill) else 0.0


def step_text(step: Step) -> str:
    """Say a step in words, for the plan's table and ``--dry-run``."""
    match step:
        case HomeStage():
            return "home the stage"
        case MoveStage():
            return f"move the display to position {step.position} ({step.position_mm:g} mm)"
        case FillTank():
            return f"fill {step.volume_ml:.0f} ml into the tank"
        case DrainTank():
            return f"drain {step.volume_ml:.0f} ml from the tank"
        case WaitUntilStill():
            return f"wait {step.duration_s:g} s: {step.reason}"
        case AskOperator():
            return f"ask: {step.text}"
        case StartSweep():
            return f"sweep {step.set_name} along {step.axis}: {step.count} photos"
        case TakePhoto():
            return f"photo {step.set_name} {step.sweep} {step.index}"
        case ChooseExposure():
            return "choose the camera's exposure time"
        case FindSweptRange():
            return f"find the part of the display that {step.set_name} sees"
        case JudgeSet():
            return f"judge the sweeps of {step.set_name}"
