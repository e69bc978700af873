"""The ``$`` settings of the emulated GRBL, with the defaults and limits of ``doc/markdown/settings.md``."""

from collections.abc import Mapping

from sim_backend.grbl_gcode import GrblError

DEFAULTS: Mapping[int, int | float] = {
    **{0: 10, 1: 25, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1, 11: 0.010, 12: 0.002, 13: 0},
    **{20: 0, 21: 0, 22: 0, 23: 0, 24: 25.0, 25: 500.0, 26: 250, 27: 1.0, 30: 1000, 31: 0, 32: 0},
    **{100: 250.0, 101: 250.0, 102: 250.0, 110: 500.0, 111: 500.0, 112: 500.0},
    **{120: 10.0, 121: 10.0, 122: 10.0, 130: 200.0, 131: 200.0, 132: 200.0},
}
# Beyond the defaults: homing, hard and soft limits on, motors always energised, 600 mm a minute.
WELL_SET_UP: Mapping[int, int | float] = {1: 255, 20: 1, 21: 1, 22: 1, 23: 0, 25: 1200.0, 110: 600.0}
WITH_DECIMALS = {11, 12, 24, 25, 27} | {number for number in DEFAULTS if number >= 100}


def well_set_up(reach_mm: float, *, pull_off_mm: float) -> dict[int, int | float]:
    """Return the settings of a stage that somebody has set up with care, and that may go ``reach_mm``."""
    return {**WELL_SET_UP, 27: pull_off_mm, 130: reach_mm + pull_off_mm}


class GrblSettings:
    """What ``$$`` lists; it lives in the EEPROM and survives a reset."""

    def __init__(self, changed: Mapping[int, int | float]) -> None:
        self._values = {**DEFAULTS, **changed}

    def __getitem__(self, number: int) -> int | float:
        return self._values[number]

    def listing(self) -> str:
        """Return the answer to ``$$`` without its ``ok``."""
        return "".join(f"${number}={self._text(number)}\r\n" for number in sorted(self._values))

    def _text(self, number: int) -> str:
        value = self._values[number]
        return f"{value:.3f}" if number in WITH_DECIMALS else f"{value:.0f}"

    def is_beyond_travel(self, machine_mm: tuple[float, float, float]) -> bool:
        """Tell whether a place lies outside the soft limits: machine space is negative, from -$130 to 0."""
        slack_mm = 1e-6
        return any(
            not -self._values[130 + axis] - slack_mm <= place_mm <= slack_mm for axis, place_mm in enumerate(machine_mm)
        )

    def store(self, number_text: str, value_text: str) -> None:
        """Take ``$number=value``; raises :class:`GrblError` as GRBL answers."""
        try:
            number, value = int(number_text), float(value_text)
        except ValueError:
            raise GrblError(2) from None
        if number not in self._values:
            raise GrblError(3)
        if value < 0:
            raise GrblError(4)
        if number == 0 and value < 3:
            raise GrblError(6)
        if number == 20 and value and not self._values[22]:
            raise GrblError(10)
        self._values[number] = value
        if number == 22 and not value:
            self._values[20] = 0
