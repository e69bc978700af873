"""Numbers as a person reads them: three significant digits, a unit, and a dash where there is nothing."""

import math
from dataclasses import dataclass

# Counts come as int and measures as float; both are written by the same functions.
Real = int | float
NOTHING = "—"
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True, slots=True)
class LengthUnit:
    """How a stored millimetre is called on the page: mm, or scene unit for a session without physical units."""

    label: str
    physical: bool

    @classmethod
    def of(cls, name: str) -> "LengthUnit":
        """Return the unit of a manifest's ``length_unit``."""
        return cls("mm", True) if name == "mm" else cls("scene units", False)

    def rename(self, unit: str) -> str:
        """Return the name of a metrics' unit on the page: mm as this session's length, deg as its sign."""
        names = {"deg": "°", "mm": self.label}
        return " ".join(names.get(word, word) for word in unit.split())


def number(value: Real | None, digits: int = 3) -> str:
    """Write a number with ``digits`` significant digits, and whole numbers in full.

    Examples
    --------
    >>> number(0.04127), number(1234567), number(-12.0), number(0.00001234), number(float("nan"))
    ('0.0413', '1,234,567', '−12.0', '1.23 × 10⁻⁵', '—')
    """
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return NOTHING
    if isinstance(value, int):
        return f"{value:,}".replace("-", "−")
    if value == 0:
        return "0"
    mantissa, _, exponent_text = f"{value:.{digits - 1}e}".partition("e")
    exponent = int(exponent_text)
    if not -4 <= exponent < 6:
        return f"{mantissa} × 10{str(exponent).translate(SUPERSCRIPT)}".replace("-", "−", 1)
    rounded = float(f"{mantissa}e{exponent_text}")
    return f"{rounded:,.{max(0, digits - 1 - exponent)}f}".replace("-", "−")


def share(part: Real, whole: Real) -> str:
    """Write a part of a whole in per cent; only everything is 100 %, and only nothing is 0 %.

    Examples
    --------
    >>> share(946, 1000), share(99_999, 100_000), share(1, 1_000_000), share(0, 0)
    ('94.6 %', '> 99.9 %', '< 0.01 %', '—')
    """
    if not whole:
        return NOTHING
    percent = 100 * part / whole
    if part and percent < 0.01:
        return "< 0.01 %"
    if part != whole and percent > 99.9:
        return "> 99.9 %"
    return f"{number(float(percent))} %"


def duration(seconds: Real) -> str:
    """Write a duration in the largest units that matter.

    Examples
    --------
    >>> duration(0.0421), duration(75.2), duration(3900)
    ('42.1 ms', '1 min 15 s', '1 h 05 min')
    """
    if not math.isfinite(seconds):
        return NOTHING
    if seconds < 1:
        return f"{number(1000 * seconds)} ms"
    if seconds < 60:
        return f"{number(float(seconds))} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def memory(megabytes: Real) -> str:
    """Write an amount of memory in MB or GB.

    Examples
    --------
    >>> memory(512.4), memory(14_300.0)
    ('512 MB', '14.3 GB')
    """
    return f"{number(megabytes / 1000)} GB" if megabytes >= 1000 else f"{number(float(megabytes))} MB"


def plus_minus(value: float, sd: float) -> str:
    """Write a value to the second digit of its standard deviation.

    Examples
    --------
    >>> plus_minus(2.19987, 0.00039), plus_minus(119.83, 1.2), plus_minus(240.0, 0.0)
    ('2.19987 ± 0.00039', '119.8 ± 1.2', '240 ± 0')
    """
    if not (math.isfinite(sd) and sd > 0):
        return f"{number(value)} ± {number(sd, 2)}"
    decimals = max(0, 1 - math.floor(math.log10(sd)))
    return f"{value:,.{decimals}f} ± {sd:.{decimals}f}".replace("-", "−")
