"""How the emulated GRBL looks for its homing switch, and in which ways it fails to find it."""

from collections.abc import Generator
from dataclasses import dataclass

from drivers.protocols import Clock
from sim_backend.grbl_axes import GrblAxes
from sim_backend.grbl_settings import GrblSettings

SEARCH_REACH = 1.5  # of $130, how far homing looks for its switch
PULL_OFF_FAILED, SWITCH_NOT_FOUND = 8, 9


@dataclass(frozen=True, slots=True)
class GrblFaults:
    """What is broken in the machine itself."""

    homing_switch_is_dead: bool = False
    pull_off_is_stuck: bool = False
    no_switch_on_z: bool = False  # the default build homes Z first, and this machine has none
    eeprom_is_corrupt: bool = False
    homing_ends_with: int = 0  # the alarm of something else: 7 the door opened, 10 the second motor missed its switch


def homing_cycle(
    axes: GrblAxes, *, clock: Clock, settings: GrblSettings, faults: GrblFaults, x_only: bool
) -> Generator[None, None, int]:
    """Move the carriage, one step of this generator at a time; return 0, or the number of the alarm."""
    # A switch at the upper end of the axis (bit clear in $23) is approached in the machine's positive direction.
    at_upper_end = not int(settings[23]) & 1
    axes.toward_switch = 1.0 if at_upper_end else -1.0
    seek_mm_per_s, locate_mm_per_s = settings[25] / 60, settings[24] / 60
    if not x_only and faults.no_switch_on_z:
        yield from _let_pass(SEARCH_REACH * settings[132] / seek_mm_per_s, clock=clock)
        return SWITCH_NOT_FOUND
    switch_mm, rest_mm = axes.switch_mm, axes.switch_mm + settings[27]
    yield from _drive(axes, switch_mm, seek_mm_per_s)
    if faults.homing_ends_with:
        return faults.homing_ends_with
    if faults.homing_switch_is_dead:
        yield from _let_pass(SEARCH_REACH * settings[130] / seek_mm_per_s, clock=clock)
        return SWITCH_NOT_FOUND
    if faults.pull_off_is_stuck:
        return PULL_OFF_FAILED
    yield from _drive(axes, rest_mm, seek_mm_per_s)
    yield from _drive(axes, switch_mm, locate_mm_per_s)
    yield from _drive(axes, rest_mm, seek_mm_per_s)
    axes.forget_plan()
    axes.count_from_here(-settings[27] if at_upper_end else settings[27] - settings[130])
    return 0


def _drive(axes: GrblAxes, to_mm: float, velocity_mm_per_s: float) -> Generator[None, None, None]:
    axes.drive_to_world_mm(to_mm, velocity_mm_per_s=velocity_mm_per_s)
    while axes.is_driving():
        yield


def _let_pass(duration_s: float, *, clock: Clock) -> Generator[None, None, None]:
    ends_s = clock.now_s() + duration_s
    while clock.now_s() < ends_s:
        yield
