"""What a New Era pump remembers without power, and how it reads and writes numbers (NE-1000 manual page 33)."""

import re
from dataclasses import dataclass, field

ML_PER_UNIT = {"UL": 0.001, "ML": 1.0}
ML_PER_S_PER_UNIT = {"UM": 0.001 / 60, "MM": 1 / 60, "UH": 0.001 / 3600, "MH": 1 / 3600}
NUMBER = re.compile(r"\d{0,4}\.?\d{0,3}", re.ASCII)


@dataclass(slots=True)
class Phase:
    """One phase of the pumping program; a volume of 0 pumps without end."""

    function: str = "RAT"
    rate: float = 0.0
    rate_units: str = "MM"
    volume: float = 0.0
    direction: str = "INF"


@dataclass(slots=True)
class Memory:
    """What survives a power failure."""

    address: int = 0
    diameter_mm: float = 26.59
    volume_units: str = "ML"
    safe_s: int = 0
    power_fail_restart: bool = False
    phases: dict[int, Phase] = field(default_factory=lambda: {1: Phase()})

    def phase(self, number: int) -> Phase:
        """Return phase ``number``; what was never programmed stops the program."""
        return self.phases.setdefault(number, Phase(function="STP"))


def number_in(text: str) -> float | None:
    """Return the number that the pump reads, or None: at most four digits and a point, three digits behind it."""
    if not NUMBER.fullmatch(text) or not 1 <= len(text.replace(".", "")) <= 4:
        return None
    return float(text)


def four_digits(value: float) -> str:
    """Write a number as the pump does: four digits and a point, at most three digits behind it; 9999 is the most."""
    for decimals in (3, 2, 1):
        text = f"{value:.{decimals}f}"
        if len(text) <= 5:
            return text
    return f"{min(value, 9999):.0f}."
