"""One axis of a GRBL controller: what its settings say of travel, switch, step and speed (``doc/markdown/settings.md``).

Machine space is negative and ends at 0: an axis whose homing switch stands at its upper end rests at ``-$27`` after
homing, one whose switch stands at the lower end (bit set in ``$23``) at ``$27 - $130``.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from drivers.errors import DeviceProtocolError

AxisName = Literal["X", "Y", "Z"]


@dataclass(frozen=True, slots=True)
class GrblAxis:
    """An axis and the controller's settings; positions count from where the carriage rests, away from the switch."""

    name: AxisName
    settings: dict[int, float]

    @property
    def number(self) -> int:
        """Place of this axis in a status report."""
        return "XYZ".index(self.name)

    @property
    def reach_mm(self) -> float:
        """How far the carriage may go from where it rests."""
        return self.settings[130 + self.number] - self.settings[27]

    @property
    def step_mm(self) -> float:
        """What one step of the motor moves."""
        return 1 / self.settings[100 + self.number]

    @property
    def fastest_mm_per_s(self) -> float:
        """The speed that the controller allows."""
        return self.settings[110 + self.number] / 60

    @property
    def can_home(self) -> bool:
        """Whether homing is switched on."""
        return bool(self.settings[22])

    def machine_mm(self, position_mm: float) -> float:
        """Return the machine coordinate of a position."""
        rest_mm, away = self._rest()
        return rest_mm + away * position_mm

    def position_mm(self, machine_mm: float) -> float:
        """Return the position of a machine coordinate."""
        rest_mm, away = self._rest()
        return away * (machine_mm - rest_mm)

    def _rest(self) -> tuple[float, int]:
        switch_at_lower_end = int(self.settings[23]) >> self.number & 1
        pull_off_mm = self.settings[27]
        return (pull_off_mm - self.settings[130 + self.number], 1) if switch_at_lower_end else (-pull_off_mm, -1)

    def advice(self, *, velocity_mm_per_s: float) -> tuple[str, ...]:
        """Return what the operator may want to change; nothing here stops a capture."""
        advice = []
        idle_ms = self.settings.get(1, 0.0)
        if idle_ms != 255:
            advice.append(
                f"$1={idle_ms:g} lets the motor go slack {idle_ms:g} ms after each move, and the carriage may drift "
                "between sets; send $1=255"
            )
        if not self.settings.get(20):
            advice.append("$20=0: the controller does not guard its travel itself; send $20=1")
        if not self.settings.get(21):
            advice.append("$21=0: limit switches do not stop a move; send $21=1 if the stage has them")
        if velocity_mm_per_s > self.fastest_mm_per_s:
            advice.append(
                f"velocity_mm_per_s is {velocity_mm_per_s:g}, the controller allows {self.fastest_mm_per_s:g} "
                f"(${110 + self.number}); lower the one or raise the other"
            )
        return tuple(advice)

    def check(self, travel_mm: tuple[float, float]) -> None:
        """Raise ``DeviceProtocolError`` for settings that would mislead a move."""
        if self.settings[13]:
            raise DeviceProtocolError(
                "stage: the controller reports inches ($13=1); send $13=0 once with a terminal program"
            )
        low_mm, high_mm = travel_mm
        if not (low_mm >= 0 and high_mm <= self.reach_mm):  # also refuses NaN
            raise DeviceProtocolError(
                f"stage: travel_mm is {low_mm:g} to {high_mm:g} mm, the controller allows 0 to {self.reach_mm:g} mm "
                f"(${130 + self.number} less $27); correct the one that is wrong"
            )


def read_axis(listing: Iterable[str], *, name: AxisName) -> GrblAxis:
    """Return an axis from the lines of ``$$``; raises ``DeviceProtocolError`` when a setting of GRBL 1.1 is missing."""
    settings = {}
    for line in listing:
        # Up to version 0.9 a comment followed the number.
        match = re.fullmatch(r"\$(\d+)=(\d+(?:\.\d*)?)(?: .*)?", line)
        if match:
            settings[int(match[1])] = float(match[2])
    axis = GrblAxis(name, settings)
    needed = (13, 22, 23, 27, 100 + axis.number, 110 + axis.number, 130 + axis.number)
    missing = [f"${number}" for number in needed if number not in settings]
    if missing or min(settings[100 + axis.number], settings[110 + axis.number]) <= 0:
        raise DeviceProtocolError(
            f"stage: the controller's settings were asked, {', '.join(missing) or 'a step or speed of 0'} found missing; "
            "use a GRBL 1.1 firmware and set up the axis"
        )
    return axis
