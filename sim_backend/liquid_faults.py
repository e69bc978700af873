"""What can go wrong with liquid, tubing and relays, whatever the electronics say: switches that a test turns."""

from dataclasses import dataclass


@dataclass(slots=True)
class LiquidFaults:
    """The faults of one world; a fresh one has none.

    ``pump_factor``: liquid that really moves for each millilitre that the pump counts. ``welded``: the pump's relay does not
    let go, so a pump that turns goes on turning. ``siphon_ml_per_s``: what runs through the hose by itself, into the tank
    when positive, out of it when negative.
    """

    pump_factor: float = 1.0
    welded: bool = False
    siphon_ml_per_s: float = 0.0
