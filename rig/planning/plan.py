"""What a capture will do, as data: a tuple of steps that can be printed, counted, tested and run.

``plan_capture`` is pure. It plans from what is already done and what the tank holds towards four whole sets, so that
resuming a capture is planning it again.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from recon.calibration.board import BOARD
from recon.patterns.coarse_scan import scan_name
from recon.patterns.pattern_frames import place_of_photo
from recon.scene.scene_check import REFERENCE
from recon.sessions.journal import SweepRange
from recon.sessions.manifest import Axis
from rig.config import RigConfig, Tank, longest_run_s
from rig.planning.reference_plan import with_references
from rig.planning.steps import (
    AskOperator,
    ChooseExposure,
    DrainTank,
    FillTank,
    FindSweptRange,
    HomeStage,
    JudgeSet,
    MoveStage,
    PhotoKey,
    Position,
    SetPlace,
    StartSweep,
    Step,
    TakePhoto,
    WaitUntilStill,
    step_duration_s,
)

# A level read from a sensor or a ruler is good to about one per cent of the fill.
LEVEL_TOLERANCE = 0.01
AXES: tuple[Axis, ...] = ("x", "y")

ORDERS: dict[tuple[str, str], tuple[SetPlace, ...]] = {
    ("liquid", "one_fill"): ((0, "air"), (1, "air"), (1, "liquid"), (0, "liquid")),
    ("liquid", "paper"): ((0, "air"), (0, "liquid"), (1, "air"), (1, "liquid")),
    ("thin", "one_fill"): ((0, "without"), (1, "without"), (1, "with"), (0, "with")),
    ("thin", "paper"): ((0, "without"), (0, "with"), (1, "without"), (1, "with")),
}


def set_order(config: RigConfig) -> tuple[SetPlace, ...]:
    """Return the sets in the order in which they are photographed: four, or two where the camera gives a thin object's rays."""
    order = ORDERS[config.method, config.capture.order]
    rays = config.capture.visual_rays
    if rays is None or rays.source == "photographed":
        return order
    return tuple(place for place in order if place[1] == "with")


def set_name(place: SetPlace) -> str:
    """Return a set's name as in the session, such as ``pos0_air``."""
    return f"pos{place[0]}_{place[1]}"


def all_photos(config: RigConfig, ranges: Mapping[tuple[str, str], SweepRange] | None = None) -> tuple[TakePhoto, ...]:
    """Return every photo of the capture in order; frame numbers count them from 0 and stay the same on resuming.

    ``ranges`` leaves out the stripes that a scan found to be unseen.
    """
    listed: list[tuple[str, str, int, float | None]] = []
    for place in set_order(config):
        name = set_name(place)
        listed += [(name, "white", 0, None), (name, "black", 0, None)]
        if config.capture.board is not None:
            listed += [(name, BOARD, number, None) for number in range(config.capture.board.photos)]
        for axis in AXES:
            listed += [(name, scan_name(axis), bit, None) for bit in range(config.scan_bits(axis))]
        for axis in AXES:
            pattern = config.pattern(axis)
            listed += [(name, axis, k, place_of_photo(pattern, k)) for k in range(pattern.count)]
    photos = (TakePhoto(*photo, frame_id=frame_id) for frame_id, photo in enumerate(listed))
    return tuple(photo for photo in photos if _is_seen(photo, ranges or {}))


def _is_seen(photo: TakePhoto, ranges: Mapping[tuple[str, str], SweepRange]) -> bool:
    found = ranges.get((photo.set_name, photo.sweep))
    return found is None or found.first_index <= photo.index <= found.last_index


def reference_photo(config: RigConfig) -> TakePhoto:
    """Return the photo of the reference frame, whose number follows those of all others; its set is filled in by the plan."""
    return TakePhoto("", REFERENCE, 0, None, frame_id=len(all_photos(config)))


def plan_capture(
    config: RigConfig,
    *,
    done: Collection[PhotoKey] = frozenset(),
    ranges: Mapping[tuple[str, str], SweepRange] | None = None,
    judged: Collection[tuple[str, str]] = frozenset(),
    tank_ml: float = 0.0,
    position: Position | None = None,
    object_present: bool | None = None,
) -> tuple[Step, ...]:
    """Plan the way from the present state to four whole sets.

    Parameters
    ----------
    config
        What to capture.
    done
        Photos that exist and are whole; they are not taken again.
    ranges
        What the scans have found so far, by set and axis.
    judged
        Set and axis of the sweeps that were found good.
    tank_ml
        What the tank holds at the start.
    position
        Where the display stands; None where that is not known, and the stage is homed first.
    object_present
        Whether the object is in its holder; None where that is not known.

    Returns
    -------
    tuple of Step
        Empty when every photo is done and the tank is as it should be left.
    """
    ranges = ranges or {}
    wanted = [photo for photo in all_photos(config, ranges) if photo.key not in done]
    steps: list[Step] = [HomeStage()] if wanted and position is None else []
    for place in set_order(config):
        photos = [photo for photo in wanted if photo.set_name == set_name(place)]
        to_judge = [JudgeSet(set_name(place))] if _is_to_judge(set_name(place), judged, config) else []
        if not photos:
            steps += to_judge
            continue
        if position != place[0]:
            position = place[0]
            steps += _go_to(position, config)
        if config.tank is not None and place[1] in ("air", "liquid"):
            target_ml = config.tank.fill_ml if place[1] == "liquid" else 0.0
            steps += _bring_tank_to(target_ml, from_ml=tank_ml, tank=config.tank, config=config)
            tank_ml = target_ml
        if place[1] in ("with", "without") and object_present != (place[1] == "with"):
            object_present = place[1] == "with"
            steps.append(_ask_for_object(object_present, config.object.name))
        if config.capture.auto_exposure is not None and not done and place == set_order(config)[0]:
            steps.append(ChooseExposure(photos[0]))
        unknown = any(config.scan_bits(axis) and (set_name(place), axis) not in ranges for axis in AXES)
        steps += _photograph(photos, find_range=unknown)
        steps += to_judge
    if config.tank is not None and config.tank.drain_at_end and config.tank.has_pump and tank_ml > 0:
        steps.append(DrainTank(tank_ml, 0.0, longest_run_s(tank_ml, config.tank)))
    if config.watch is not None:
        steps = with_references(steps, done=done, photo=reference_photo(config))
    return tuple(steps)


def _go_to(position: Position, config: RigConfig) -> Iterator[Step]:
    yield MoveStage(position, config.stage.position_mm(position))
    if config.timing.still_after_move_s > 0:
        yield WaitUntilStill(config.timing.still_after_move_s, "the display was moved")


def _bring_tank_to(target_ml: float, *, from_ml: float, tank: Tank, config: RigConfig) -> Iterator[Step]:
    """Plan the flow that makes the tank hold ``target_ml``; none when it does already."""
    volume_ml = target_ml - from_ml
    if abs(volume_ml) <= LEVEL_TOLERANCE * tank.fill_ml:
        return
    liquid = config.liquid.name if config.liquid else "liquid"
    filling = volume_ml > 0
    if not tank.has_pump and filling:
        text = f"Fill the tank slowly with {liquid} until it holds {target_ml:g} ml"
        yield AskOperator("fill_tank", f"{text}; do not touch object or camera.")
    elif not tank.has_pump:
        yield AskOperator("drain_tank", f"Drain the tank down to {target_ml:g} ml; do not touch object or camera.")
    elif filling:
        yield FillTank(volume_ml, target_ml, longest_run_s(volume_ml, tank))
    else:
        yield DrainTank(-volume_ml, target_ml, longest_run_s(-volume_ml, tank))
    if config.timing.still_after_fill_s > 0:
        yield WaitUntilStill(config.timing.still_after_fill_s, "the liquid was moved")


def _ask_for_object(present: bool, name: str) -> AskOperator:
    if present:
        return AskOperator("insert_object", f"Put the object ({name}) into its holder; do not touch the camera.")
    return AskOperator("remove_object", f"Take the object ({name}) out of its holder; do not touch the camera.")


def _is_to_judge(name: str, judged: Collection[tuple[str, str]], config: RigConfig) -> bool:
    return config.live is not None and any((name, axis) not in judged for axis in AXES)


def _photograph(photos: list[TakePhoto], *, find_range: bool) -> Iterator[Step]:
    """Yield the photos of one set, each sweep announced with the number of its photos; before them, what scan found."""
    counts = Counter(photo.sweep for photo in photos)
    announced: str | None = None
    for photo in photos:
        if photo.sweep != announced:
            announced = photo.sweep
            if announced in AXES:
                if find_range:
                    yield FindSweptRange(photo.set_name)
                    find_range = False
                yield StartSweep(photo.set_name, announced, counts[announced])
        yield photo


@dataclass(frozen=True, slots=True)
class PlanSummary:
    """What a plan costs. ``minutes`` leaves out the time that a person takes."""

    sets: int
    photos: int
    moves: int
    fills: int
    drains: int
    questions: int
    litres: float
    gigabytes: float
    minutes: float


def summarise(plan: tuple[Step, ...], config: RigConfig) -> PlanSummary:
    """Count a plan and estimate its time and size."""
    photos = [step for step in plan if isinstance(step, TakePhoto)]
    flows = [step for step in plan if isinstance(step, FillTank | DrainTank)]
    return PlanSummary(
        sets=len({photo.set_name for photo in photos}),
        photos=len(photos),
        moves=sum(isinstance(step, MoveStage) for step in plan),
        fills=sum(isinstance(step, FillTank) for step in plan),
        drains=sum(isinstance(step, DrainTank) for step in plan),
        questions=sum(isinstance(step, AskOperator) for step in plan),
        litres=sum(flow.volume_ml for flow in flows) / 1000,
        gigabytes=len(photos) * config.timing.photo_mb / 1000,
        minutes=sum(step_duration_s(step, config) for step in plan) / 60,
    )
