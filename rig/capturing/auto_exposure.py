"""The camera's exposure time, chosen from photos of the white display before the first set, and frozen for all of them.

The time must hold whole refresh periods of the display, two at least, or a photo's brightness would vary with the moment of its
exposure. Of these times the longest is taken whose white photo keeps clear of clipping by a margin: with liquid less light is
reflected, and photos can get brighter.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.exposure_time import seconds_of
from recon.sessions.photos import Counts, saturation_count
from rig.capture_sections import AutoExposure

FEWEST_PERIODS = 2
# A refresh period that is cut in two may change the light of a photo by a hundredth.
LARGEST_BROKEN_SHARE = 0.01
# Of ten million pixels, a few thousand may be glints.
BRIGHTEST_QUANTILE = 0.999
# A set is called clipped when more of its pixels are.
CLIPPED_SHARE = 1 - BRIGHTEST_QUANTILE


@dataclass(frozen=True, slots=True)
class Brightness:
    """How bright a photo is: its brightest pixels but for glints, as a share of the range of counts, and the share clipped."""

    brightest: float
    clipped: float


@dataclass(frozen=True, slots=True)
class ChosenExposure:
    """The value of the setting, empty where the body cannot be set; and a sentence for the operator, empty if all is well."""

    value: str
    brightness: Brightness
    warning: str


def usable_times(choices: Sequence[str], *, refresh_hz: float) -> list[str]:
    """Return the times, the shortest first, that hold whole refresh periods of the display, and two at least."""
    found: dict[float, str] = {}
    for choice in choices:
        time_s = seconds_of(choice)
        if time_s is None:
            continue
        periods = time_s * refresh_hz
        broken_share = abs(periods - round(periods)) / periods
        if round(periods) >= FEWEST_PERIODS and broken_share <= LARGEST_BROKEN_SHARE:
            found.setdefault(time_s, choice)
    return [found[time_s] for time_s in sorted(found)]


def brightness_of(counts: Counts, seen_px: tuple[int, int, int, int] | None) -> Brightness:
    """Measure a photo within ``seen_px`` (first column, first row, last column, last row)."""
    left, top, right, bottom = seen_px or (0, 0, counts.shape[1] - 1, counts.shape[0] - 1)
    part = counts[top : bottom + 1, left : right + 1]
    return Brightness(
        brightest=float(np.quantile(part, BRIGHTEST_QUANTILE)) / float(np.iinfo(counts.dtype).max),
        clipped=float((part >= saturation_count(counts)).mean()),
    )


def choose_time(
    times: Sequence[str], *, wanted: AutoExposure, brightness_at: Callable[[str], Brightness]
) -> ChosenExposure:
    """Choose among ``times``, the shortest first, by halving; ``brightness_at`` sets one and photographs the white display."""
    low, high = 0, len(times) - 1  # the longest that is not too bright lies in low … high, if there is one
    best = brightness_at(times[0])
    if best.brightest > wanted.brightest_share:
        return ChosenExposure(times[0], best, _too_bright(times[0], best, wanted))
    while low < high:
        middle = (low + high + 1) // 2
        found = brightness_at(times[middle])
        if found.brightest > wanted.brightest_share:
            high = middle - 1
        else:
            low, best = middle, found
    return ChosenExposure(times[low], best, fault_of(best, wanted, where=f"the white display at {times[low]} s"))


def fault_of(found: Brightness, wanted: AutoExposure, *, where: str) -> str:
    """Say what is wrong with the brightness of a white photo, or nothing."""
    if found.clipped > CLIPPED_SHARE:
        return (
            f"exposure: {found.clipped:.1%} of {where} is clipped; stripes lose their peaks there: lower "
            "capture.auto_exposure.brightest_share in a new session, or dim the display"
        )
    if found.brightest < wanted.darkest_share:
        return (
            f"exposure: {where} reaches {found.brightest:.0%} of the range, {wanted.darkest_share:.0%} asked; brighten the "
            "display, open the aperture or raise the sensitivity"
        )
    return ""


def _too_bright(time: str, found: Brightness, wanted: AutoExposure) -> str:
    return (
        f"exposure: at {time} s, the shortest time that holds {FEWEST_PERIODS} or more whole refresh periods, the white display "
        f"reaches {found.brightest:.0%} of the range, at most {wanted.brightest_share:.0%} asked; close the aperture, lower "
        "the sensitivity or dim the display"
    )
