"""From a stripe's sweep to the pattern with fewer photos that tells the same places apart."""

from pydantic import ValidationError

from recon.bad_value import reason_of
from recon.patterns.phase_shift import periods_for
from recon.sessions.pattern import GrayLinePattern, Pattern, PhaseShiftPattern, StripePattern
from rig.capture_sections import GrayLineCode, PhaseShiftCode


def coded_pattern(sweep: StripePattern, code: GrayLineCode | PhaseShiftCode | None) -> Pattern:
    """Return what is shown instead of a sweep over the same places; the sweep itself without a code.

    Raises ``ValueError`` with one sentence where stripe and code do not go together.
    """
    try:
        if isinstance(code, GrayLineCode):
            return _lines(sweep, code)
        if isinstance(code, PhaseShiftCode):
            return _fringes(sweep, code)
    except ValidationError as error:
        reason = reason_of(error.errors()[0])
        raise ValueError(f"[capture.code] does not go with [capture.stripe] and [capture.swept]: {reason}") from None
    return sweep


def _lines(sweep: StripePattern, code: GrayLineCode) -> GrayLinePattern:
    return GrayLinePattern(
        kind="gray_line",
        profile=sweep.profile,
        width_px=sweep.width_px,
        first_px=sweep.first_px,
        step_px=sweep.step_px,
        period_px=code.period_px,
        places=sweep.count,
    )


def _fringes(sweep: StripePattern, code: PhaseShiftCode) -> PhaseShiftPattern:
    last_px = sweep.first_px + sweep.step_px * (sweep.count - 1)
    area_px = last_px - sweep.first_px + 1
    return PhaseShiftPattern(
        kind="phase_shift",
        periods_px=periods_for(area_px, finest_px=code.finest_period_px, frequencies=code.frequencies),
        steps=code.steps,
        first_px=sweep.first_px,
        last_px=last_px,
    )
