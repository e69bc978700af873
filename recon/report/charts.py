"""Geometry of the small vector charts: where a number falls, round tick values, and paths."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from recon.report.numbers import Real, number


@dataclass(frozen=True, slots=True)
class Scale:
    """A straight map from values to places on the drawing; ``from_place`` may lie right of or below ``to_place``."""

    low: Real
    high: Real
    from_place: Real
    to_place: Real

    def place(self, value: Real) -> float:
        """Return where ``value`` falls, rounded to a hundredth of a drawing unit."""
        span = self.high - self.low or 1.0
        return round(float(self.from_place + (value - self.low) / span * (self.to_place - self.from_place)), 2)

    def ticks(self, wanted: int = 4) -> tuple[tuple[float, str], ...]:
        """Return places and labels of about ``wanted`` round values."""
        return tuple(
            (self.place(value), number(value if abs(value) < 1e6 else float(value)) if value else "0")
            for value in self._round_values(wanted)
        )

    def _round_values(self, wanted: int) -> list[Real]:
        """Return the multiples of 1, 2 or 5 times a power of ten inside the scale."""
        step = round_up((self.high - self.low) / max(wanted, 1))
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        decimals = max(0, -math.floor(math.log10(step)))
        values = [round(step * k, decimals) for k in range(first, last + 1)]
        return [int(value) if value.is_integer() else value for value in values]


def round_up(value: Real) -> float:
    """Return the least of 1, 2, 5 times a power of ten that is at least ``value``.

    Examples
    --------
    >>> round_up(0.3), round_up(6.0), round_up(1.0)
    (0.5, 10.0, 1.0)
    """
    if not value > 0 or not math.isfinite(value):
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * (1 - 1e-12))


def line_path(x: Scale, y: Scale, points: Sequence[tuple[Real, Real]]) -> str:
    """Return the path through the points; a value that is not finite lifts the pen."""
    words: list[str] = []
    pen = "M"
    for across, up in points:
        if not (math.isfinite(across) and math.isfinite(up)):
            pen = "M"
            continue
        words.append(f"{pen}{x.place(across):g} {y.place(up):g}")
        pen = "L"
    return "".join(words)


def area_path(x: Scale, y: Scale, points: Sequence[tuple[Real, Real]]) -> str:
    """Return the closed path between the points and the foot of the scale."""
    line = line_path(x, y, [(across, up if math.isfinite(up) else y.low) for across, up in points])
    if not line:
        return ""
    foot = y.place(y.low)
    return f"{line}L{x.place(points[-1][0]):g} {foot:g}L{x.place(points[0][0]):g} {foot:g}Z"
