"""How long a shutter is open, read from the words in which cameras write it."""

import math


def seconds_of(shutterspeed: str) -> float | None:
    """Read a shutter speed, ``1/4``, ``0.3`` or ``0.25s``; None for anything else, such as ``bulb``."""
    over, slash, under = shutterspeed.removesuffix("s").strip().partition("/")
    try:
        exposure_s = float(over) / float(under) if slash else float(over)
    except (ValueError, ZeroDivisionError):
        return None
    return exposure_s if math.isfinite(exposure_s) and exposure_s > 0 else None
