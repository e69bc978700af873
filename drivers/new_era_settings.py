"""What a New Era pump must be told before it may run, and the proof that it took it."""

import math
import re
from dataclasses import dataclass

from drivers.errors import DeviceAlarmError, DeviceProtocolError, OutOfVolumeError
from drivers.new_era_link import NewEraLink
from drivers.new_era_wire import four_digits, parse_value
from drivers.protocols import FlowDirection

ML_PER_UNIT = {"UL": 0.001, "ML": 1.0}
ML_PER_MIN_PER_UNIT = {"MM": 1.0, "UM": 0.001, "MH": 1 / 60, "UH": 0.001 / 60}
# At and below this inside diameter the pump counts in microlitres, above it in millilitres (NE-500 quick start).
MICROLITRES_UP_TO_MM = 14.00
# Four digits carry one part in 2000 at worst; units that carry less are not used.
WORST_ROUNDING = 1e-3
PREPARATIONS = 3


@dataclass(frozen=True, slots=True)
class Flow:
    """How the pump calls a direction, and what its prompt says while it pumps that way."""

    setting: str
    prompt: str


FLOW: dict[FlowDirection, Flow] = {"fill": Flow("INF", "I"), "drain": Flow("WDR", "W")}


@dataclass(frozen=True, slots=True)
class Settings:
    """One run in the pump's own words; ``volume_ml`` is what those words come to."""

    direction: str
    diameter: str
    rate: str
    rate_units: str
    volume: str
    volume_units: str
    volume_ml: float


def settings_for(
    direction: FlowDirection, *, volume_ml: float, max_run_s: float, rate_ml_per_min: float, diameter_mm: float
) -> Settings:
    """Return what to tell the pump; it will not pump longer than ``max_run_s`` even if nobody ever asks again.

    Raises
    ------
    OutOfVolumeError
        For a volume, time or rate that is not positive, or that four digits cannot hold.
    """
    if not 0 < volume_ml < math.inf:
        raise OutOfVolumeError(f"pump: {volume_ml:g} ml asked, a {direction} needs a volume above 0 ml")
    if not 0 < max_run_s < math.inf:
        raise OutOfVolumeError(f"pump: a longest run of {max_run_s:g} s asked, it must be above 0 s")
    if not 0 < rate_ml_per_min < math.inf:
        raise OutOfVolumeError(f"pump: a rate of {rate_ml_per_min:g} ml/min is configured, it must be above 0 ml/min")
    volume_ml = min(volume_ml, rate_ml_per_min * max_run_s / 60)
    diameter = four_digits(diameter_mm)
    usual = "UL" if float(diameter) <= MICROLITRES_UP_TO_MM else "ML"
    volume, volume_units = in_units(volume_ml, {usual: ML_PER_UNIT[usual]} | ML_PER_UNIT)
    rate, rate_units = in_units(rate_ml_per_min, ML_PER_MIN_PER_UNIT)
    return Settings(
        FLOW[direction].setting,
        diameter,
        rate,
        rate_units,
        volume,
        volume_units,
        float(volume) * ML_PER_UNIT[volume_units],
    )


def in_units(value: float, size_of: dict[str, float]) -> tuple[str, str]:
    """Write ``value`` in the first of the units that carries it well, or say that none does."""
    for units, size in size_of.items():
        try:
            text = four_digits(value / size)
        except OutOfVolumeError:
            continue
        if abs(float(text) * size - value) <= WORST_ROUNDING * value:
            return text, units
    raise OutOfVolumeError(
        f"pump: {value:g} asked (ml, or ml/min for a rate); the four digits of this pump would make it something else, "
        f"and 0 means without end. Its numbers go from 0.001 to 9999 in {' or '.join(size_of)}"
    )


def prepare(link: NewEraLink, settings: Settings) -> None:
    """Tell a pump that stands everything about the next run and read it back.

    Raises
    ------
    DeviceProtocolError
        When something reads back other than it was sent.
    DeviceAlarmError
        When the pump rings each time.
    """
    for _ in range(PREPARATIONS):
        rung = link.alarms_acknowledged
        tell_everything(link, settings)
        if link.alarms_acknowledged == rung:
            return
        # A pump that was reset half-way has forgotten which phase the settings before were for.
    raise DeviceAlarmError("pump: it rings again and again while it is prepared; look at the pump and its power supply")


def tell_everything(link: NewEraLink, settings: Settings) -> None:
    """Set and read back program, direction, rate and volume, and clear the counters."""
    keep_to_one_phase(link)
    forbid_restart_after_power_failure(link)
    settle(link, "DIA", settings.diameter)
    settle(link, "DIR", settings.direction)
    settle(link, "RAT", settings.rate, settings.rate_units)
    if parse_value(link.ask("VOL"))[1] != settings.volume_units:
        link.ask(f"VOL{settings.volume_units}")
    settle(link, "VOL", settings.volume, settings.volume_units)
    link.ask("CLDINF")
    link.ask("CLDWDR")
    for direction in FLOW:
        if dispensed_ml(link, direction) != 0:
            raise DeviceProtocolError(
                f"pump: its counter of the {direction} does not go to zero; switch it off and on, then try again"
            )


def settle(link: NewEraLink, name: str, value: str, units: str = "") -> None:
    """Set ``name`` unless it is set already, which spares the pump's memory, and read it back."""
    if says(link.ask(name), value, units):
        return
    # Units of volume are a command of their own.
    link.ask(f"{name}{value}{units if name == 'RAT' else ''}")
    found = link.ask(name)
    if not says(found, value, units):
        raise DeviceProtocolError(
            f"pump: {name} {value}{units} was sent, it says {found!r}; nothing was started. The value may be beyond this "
            "pump or its tubing: compare with its manual"
        )


def says(found: str, value: str, units: str) -> bool:
    """Tell whether the pump's answer ``found`` means ``value`` in ``units``; it writes 4500 as ``4500.``."""
    if value.isalpha():
        return found == value
    number, found_units = parse_value(found)
    return number == float(value) and found_units == units


def keep_to_one_phase(link: NewEraLink) -> None:
    """Let the program end after phase 1: a program that somebody left behind would go on with its next phase."""
    chosen = link.acknowledged("PHN2")
    if chosen.data.startswith("?"):
        return  # a model without programs
    if link.ask("FUN") != "STP":
        link.ask("FUNSTP")
        if (found := link.ask("FUN")) != "STP":
            raise DeviceProtocolError(
                f"pump: phase 2 of its program should stop, it says {found!r}; clear the program at the pump's keypad"
            )
    link.ask("PHN1")
    settle(link, "FUN", "RAT")


def forbid_restart_after_power_failure(link: NewEraLink) -> None:
    """Refuse a pump that would start by itself when the power comes back (PF, NE-1000 page 37)."""
    if parse_value(link.ask("PF"))[0] != 0:
        link.ask("PF0")
        if parse_value(link.ask("PF"))[0] != 0:
            raise DeviceProtocolError(
                "pump: it would start by itself after a power failure and does not let that be switched off (PF 0); "
                "switch it off in the pump's setup menu"
            )


def dispensed_ml(link: NewEraLink, direction: FlowDirection) -> float:
    """Return what the pump's head has turned in one direction since the counters were cleared; turns, not liquid."""
    text = link.ask("DIS")
    counts = re.fullmatch(r"I([\d.]+)W([\d.]+)(UL|ML)", text)
    if counts is None:
        raise DeviceProtocolError(f"pump: its counter says {text!r}, which is not in the manual; check the model")
    infused, withdrawn, units = counts.groups()
    return float(infused if direction == "fill" else withdrawn) * ML_PER_UNIT[units]
