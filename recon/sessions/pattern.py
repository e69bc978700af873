"""What a display shows in one sweep, as the manifest holds it: three kinds of pattern, told apart by ``kind``.

How each looks on the display is in :mod:`recon.patterns`, how it is read back in :mod:`recon.sweeps`. Lengths are device pixels
along the axis of the sweep; pixel 0's centre is 0.
"""

import math
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]

# A step of 0.1 does not add up exactly.
WHOLE_NUMBER_TOLERANCE = 1e-6


class Part(BaseModel):
    """Common behaviour of every part of a manifest: unchangeable, and no field that we do not know."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class StripePattern(Part):
    """A bright stripe on black that is moved step by step along one axis of the display.

    ``hard``: ``width_px`` device pixels fully lit, sharp edges. ``raised_cosine``: ½(1 + cos 2πd/width_px) for
    |d| < width_px/2.
    Stripe number k is centred at ``first_px + k * step_px`` (device pixels; pixel 0's centre is 0).
    """

    kind: Literal["stripe"] = "stripe"
    profile: Literal["hard", "raised_cosine"]
    width_px: Positive
    first_px: Finite
    step_px: Positive
    count: Annotated[int, Field(ge=3)]


class GrayLinePattern(Part):
    """Bright lines a period apart, shifted step by step through one period, then a Gray code that tells which period.

    The lines are the stripes of a sweep with ``places`` steps: photo j shows all whose number k leaves j when divided by the
    steps of a period. The Gray code numbers half periods; each of its bits is shown twice, the second time inverted.
    """

    kind: Literal["gray_line"]
    profile: Literal["hard", "raised_cosine"]
    width_px: Positive
    first_px: Finite
    step_px: Positive
    period_px: Positive
    places: Annotated[int, Field(ge=3)]

    @model_validator(mode="after")
    def _lines_stand_apart(self) -> "GrayLinePattern":
        steps = self.period_px / self.step_px
        if abs(steps - round(steps)) > WHOLE_NUMBER_TOLERANCE * steps or round(steps) % 2 or steps < 4:
            raise ValueError(
                f"period_px is {self.period_px:g}, {steps:.4g} times step_px; it must be an even number of steps, 4 at least"
            )
        if self.width_px > self.period_px / 2:
            raise ValueError(
                f"width_px is {self.width_px:g}; a line may be half of period_px ({self.period_px:g}) wide at most"
            )
        if self.places <= self.steps:
            raise ValueError(f"places is {self.places}; more than the {self.steps} steps of one period are needed")
        return self

    @property
    def steps(self) -> int:
        """How many photos shift the lines through one period."""
        return round(self.period_px / self.step_px)

    @property
    def bars(self) -> int:
        """How many half periods the Gray code tells apart."""
        return math.ceil(self.places / (self.steps // 2))

    @property
    def bits(self) -> int:
        """How many bits the number of a half period has."""
        return (self.bars - 1).bit_length()

    @property
    def count(self) -> int:
        """How many photos there are: one a shift, two a bit."""
        return self.steps + 2 * self.bits

    def as_sweep(self) -> StripePattern:
        """Return the sweep whose stripes these lines are."""
        return StripePattern(
            profile=self.profile,
            width_px=self.width_px,
            first_px=self.first_px,
            step_px=self.step_px,
            count=self.places,
        )


class PhaseShiftPattern(Part):
    """Cosine fringes of several periods, each shifted ``steps`` times through one period.

    The periods come coarsest first; the coarsest is longer than the area from ``first_px`` to ``last_px`` (both included), so
    that it tells every place apart. Photo ``p * steps + k`` shows period p with the level
    ½(1 + cos 2π((u − first_px)/period − k/steps)) of full drive at place u.
    """

    kind: Literal["phase_shift"]
    periods_px: Annotated[tuple[Positive, ...], Field(min_length=1)]
    steps: Annotated[int, Field(ge=3)]
    first_px: Finite
    last_px: Finite

    @model_validator(mode="after")
    def _periods_tell_places_apart(self) -> "PhaseShiftPattern":
        area_px = self.last_px - self.first_px + 1
        if area_px < 3:
            raise ValueError(f"last_px is {self.last_px:g}, first_px {self.first_px:g}; the area needs 3 device pixels")
        if self.periods_px[0] <= area_px:
            raise ValueError(
                f"the first of periods_px is {self.periods_px[0]:g}; it must be longer than the area of {area_px:g} device pixels"
            )
        if any(fine >= coarse for coarse, fine in zip(self.periods_px, self.periods_px[1:], strict=False)):
            raise ValueError("periods_px must fall from one to the next: the coarsest first")
        return self

    @property
    def count(self) -> int:
        """How many photos there are."""
        return len(self.periods_px) * self.steps


def _kind(value: object) -> str:
    """Return the kind of a pattern that may not say it: what says nothing is a stripe."""
    if isinstance(value, dict):
        return str(value.get("kind", "stripe"))
    return str(getattr(value, "kind", "stripe"))


Pattern = Annotated[
    Annotated[StripePattern, Tag("stripe")]
    | Annotated[GrayLinePattern, Tag("gray_line")]
    | Annotated[PhaseShiftPattern, Tag("phase_shift")],
    Discriminator(_kind),
]
