"""The G-code that the emulated GRBL understands: one line of text into one order, or GRBL's own error number.

Sources: ``doc/markdown/commands.md``, ``jogging.md`` and ``doc/csv/error_codes_en_US.csv`` of gnea/grbl 1.1.
"""

import re
from dataclasses import dataclass, replace
from typing import Literal

MM_PER_INCH = 25.4
AXES = "XYZ"
# G and M words that change nothing that a stage can show.
ACCEPTED = {"G17", "G18", "G19", "G40", "G49", "G54", "G61", "G80", "G91.1", "G94"} | {
    *("M0", "M1", "M2", "M3", "M4", "M5", "M7", "M8", "M9", "M30")
}
NON_MODAL = {"G4", "G10", "G28", "G28.1", "G30", "G30.1", "G53", "G92", "G92.1"}
MOTION = {"G0", "G1"}
UNITS = {"G20", "G21"}
DISTANCE = {"G90", "G91"}


class GrblError(Exception):
    """A line that is answered with ``error:N``."""

    def __init__(self, code: int) -> None:
        super().__init__(f"error:{code}")
        self.code = code


@dataclass(frozen=True, slots=True)
class Modes:
    """What a line leaves behind for the next one."""

    motion: str = "G0"
    units: str = "G21"
    distance: str = "G90"
    feed_mm_per_min: float = 0.0

    def words(self) -> str:
        """Return them as ``$G`` tells them."""
        return f"{self.motion} G54 G17 {self.units} {self.distance} G94 M5 M9 T0 F{self.feed_mm_per_min:.0f} S0"


@dataclass(frozen=True, slots=True)
class Order:
    """What one line asks for. ``machine_mm`` is the target of a motion."""

    kind: Literal["nothing", "move", "dwell", "offset"]
    modes: Modes
    machine_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    feed_mm_per_min: float | None = None  # None: as fast as the axis goes
    dwell_s: float = 0.0
    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


def strip_comments(line: str) -> str:
    """Return ``line`` as the parser sees it: no blanks, no comments, upper case."""
    return re.sub(r"\([^)]*\)|;.*|\s", "", line).upper()


def words_of(line: str) -> list[tuple[str, float]]:
    """Split a stripped line into letters and numbers; raises error 1 (no letter) or 2 (no number)."""
    words = []
    while line:
        if not line[0].isalpha():
            raise GrblError(1)
        match = re.match(r"[A-Z]([+-]?(?:\d+\.?\d*|\.\d+))", line)
        if match is None:
            raise GrblError(2)
        words.append((line[0], float(match[1])))
        line = line[match.end() :]
    return words


def read_line(
    line: str,
    *,
    modes: Modes,
    machine_mm: tuple[float, float, float],
    offset_mm: tuple[float, float, float],
) -> Order:
    """Return what a line of G-code asks for, where the tool will stand at ``machine_mm`` when it begins.

    ``offset_mm`` is where work coordinates have their zero in machine coordinates.
    """
    commands, values = _sorted_words(line)
    modes = _new_modes(commands, values, modes)
    scale = MM_PER_INCH if modes.units == "G20" else 1.0
    special = next((name for name in commands if name in NON_MODAL and name != "G53"), None)
    if special == "G4":
        if "P" not in values:
            raise GrblError(28)
        return Order("dwell", modes, dwell_s=values["P"])
    if special is not None:
        return _set_offset(special, values, modes, machine_mm, offset_mm, scale)
    if not any(axis in values for axis in AXES):
        if "G53" in commands:
            raise GrblError(26)
        return Order("nothing", modes)
    target_mm = _target(values, modes, machine_mm, offset_mm, scale, in_machine="G53" in commands)
    if modes.motion == "G0":
        return Order("move", modes, target_mm)
    if modes.feed_mm_per_min <= 0:
        raise GrblError(22)
    return Order("move", modes, target_mm, modes.feed_mm_per_min)


def read_jog(
    line: str, *, modes: Modes, machine_mm: tuple[float, float, float], offset_mm: tuple[float, float, float]
) -> Order:
    """Return what the part of ``$J=`` after the sign asks for; a jog leaves no modes behind (``jogging.md``)."""
    commands, values = _sorted_words(line)
    if any(name not in UNITS | DISTANCE | {"G53"} for name in commands):
        raise GrblError(16)
    if not any(axis in values for axis in AXES):
        raise GrblError(26)
    if values.get("F", 0.0) <= 0:
        raise GrblError(22)
    own = _new_modes(commands, values, modes)
    scale = MM_PER_INCH if own.units == "G20" else 1.0
    target_mm = _target(values, own, machine_mm, offset_mm, scale, in_machine="G53" in commands)
    return Order("move", modes, target_mm, values["F"] * scale)


def _sorted_words(line: str) -> tuple[list[str], dict[str, float]]:
    commands: list[str] = []
    values: dict[str, float] = {}
    for letter, number in words_of(line):
        if letter in "GM":
            name = f"{letter}{number:g}"
            if name not in ACCEPTED | NON_MODAL | MOTION | UNITS | DISTANCE:
                raise GrblError(20)
            commands.append(name)
        elif letter not in "XYZFSTNPL":
            raise GrblError(20)
        elif letter in values:
            raise GrblError(25)
        elif number < 0 and letter in "FSTNP":
            raise GrblError(4)
        else:
            values[letter] = number
    for group in (MOTION, UNITS, DISTANCE):
        if sum(name in group for name in commands) > 1:
            raise GrblError(21)
    return commands, values


def _new_modes(commands: list[str], values: dict[str, float], modes: Modes) -> Modes:
    for name in commands:
        if name in MOTION:
            modes = replace(modes, motion=name)
        elif name in UNITS:
            modes = replace(modes, units=name)
        elif name in DISTANCE:
            modes = replace(modes, distance=name)
    if "F" in values:
        modes = replace(modes, feed_mm_per_min=values["F"] * (MM_PER_INCH if modes.units == "G20" else 1.0))
    return modes


def _target(
    values: dict[str, float],
    modes: Modes,
    machine_mm: tuple[float, float, float],
    offset_mm: tuple[float, float, float],
    scale: float,
    *,
    in_machine: bool,
) -> tuple[float, float, float]:
    target_mm = []
    for axis, here_mm, zero_mm in zip(AXES, machine_mm, offset_mm, strict=True):
        if axis not in values:
            target_mm.append(here_mm)
        elif in_machine:
            target_mm.append(values[axis] * scale)
        elif modes.distance == "G91":
            target_mm.append(here_mm + values[axis] * scale)
        else:
            target_mm.append(zero_mm + values[axis] * scale)
    return target_mm[0], target_mm[1], target_mm[2]


def _set_offset(
    name: str,
    values: dict[str, float],
    modes: Modes,
    machine_mm: tuple[float, float, float],
    offset_mm: tuple[float, float, float],
    scale: float,
) -> Order:
    """G92 and G10 L20 call the present place by a new name; G10 L2 places the zero itself."""
    if name not in ("G92", "G92.1", "G10"):
        raise GrblError(20)
    if name == "G10" and values.get("L") not in (2.0, 20.0):
        raise GrblError(20)
    new_mm = []
    for axis, here_mm, zero_mm in zip(AXES, machine_mm, offset_mm, strict=True):
        if name == "G92.1":
            new_mm.append(0.0)
        elif axis not in values:
            new_mm.append(zero_mm)
        elif name == "G10" and values["L"] == 2.0:
            new_mm.append(values[axis] * scale)
        else:
            new_mm.append(here_mm - values[axis] * scale)
    return Order("offset", modes, offset_mm=(new_mm[0], new_mm[1], new_mm[2]))
