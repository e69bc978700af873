"""How well a stage comes back to the same place, which bounds how well its two display positions are known."""

from collections.abc import Callable
from dataclasses import dataclass
from statistics import stdev

from drivers.protocols import Stage


@dataclass(frozen=True, slots=True)
class Repeatability:
    """Readings at one place, each after a journey away and back."""

    readings_mm: tuple[float, ...]

    @property
    def spread_mm(self) -> float:
        """Largest less smallest reading."""
        return max(self.readings_mm) - min(self.readings_mm)

    @property
    def sd_mm(self) -> float:
        """Standard deviation of the readings (n - 1)."""
        return stdev(self.readings_mm)


def measure_repeatability(
    stage: Stage,
    *,
    at_mm: float,
    away_mm: float,
    times: int,
    timeout_s: float,
    read_mm: Callable[[], float] | None = None,
) -> Repeatability:
    """Move to ``away_mm`` and back to ``at_mm`` again and again, always from the same side, and read the place each time.

    ``read_mm`` measures independently of the stage, such as a dial gauge that a person reads. Without it the stage is
    asked, and a stage without encoder answers what it counts: lost steps and backlash stay hidden.

    Raises
    ------
    ValueError
        For fewer than two times, or for two places that are the same.
    DeviceError
        As the stage's moves.
    """
    if times < 2 or at_mm == away_mm:
        raise ValueError(
            f"repeatability: {times} times between {away_mm:g} and {at_mm:g} mm asked; ask for two times or more, and "
            "for two places that differ"
        )
    readings_mm = []
    for _ in range(times):
        stage.move_to_mm(away_mm, timeout_s=timeout_s)
        stage.move_to_mm(at_mm, timeout_s=timeout_s)
        readings_mm.append(stage.position_mm() if read_mm is None else read_mm())
    return Repeatability(tuple(readings_mm))
