"""How the display slipped between air and liquid, as the gaps between the light paths tell it."""

from recon.metrics import Metrics, RegistrationRecord
from recon.registration.session_slips import SIGNIFICANT_SIGMA
from recon.report.numbers import LengthUnit, number
from recon.report.panel import Panel, Table


def registration_panel(metrics: Metrics, unit: LengthUnit) -> Panel:
    """Return the motions found at both positions, and the normalised gap before and after."""
    record = metrics.registration
    reason = (
        "The method `paper` takes the poses at their word."
        if metrics.method == "paper"
        else "No registration was made: it was switched off, too few pixels have a place in all sets, or there is no liquid."
    )
    return Panel(
        "registration",
        "Display in liquid beside display in air",
        "tables.html.j2",
        {"tables": (_motions(record, unit), _gaps(record))} if record is not None else {},
        "How the display moved in its plane when the tank was filled, found by letting the two light paths of each pixel meet. "
        + (_decision(record) if record is not None else ""),
        "A normalised gap of about 1: noise alone parts the paths. This judges a session without any truth.",
        "A normalised gap of 2 and more after the correction: something else moved, or a pose, the pitch or the glass is wrong.",
        missing="" if record is not None else reason,
    )


def _motions(record: RegistrationRecord, unit: LengthUnit) -> Table:
    rows = tuple(
        (
            str(one.position),
            *(
                f"{number(value, 3)} ± {number(sd, 2)}"
                for value, sd in (
                    (one.x_mm, one.x_sd_mm),
                    (one.y_mm, one.y_sd_mm),
                    (one.turn_deg, one.turn_sd_deg),
                )
            ),
        )
        for one in record.motions
    )
    return Table(("Position", f"along x ({unit.label})", f"along y ({unit.label})", "turn (°)"), rows, (1, 2, 3))


def _gaps(record: RegistrationRecord) -> Table:
    rows = (("as the poses were given", number(record.gap_before)), ("with the motions", number(record.gap_after)))
    return Table(("Normalised gap (1 is noise alone)", ""), rows, (1,))


def _decision(record: RegistrationRecord) -> str:
    if record.applied:
        told = "were taken over"
    elif record.directions and record.sigma > SIGNIFICANT_SIGMA:
        told = "leave gaps that whole neighbourhoods share, so that these have another cause, and the poses were kept"
    elif record.directions:
        told = "are not significant and the poses were kept"
    else:
        told = "cannot be determined from these gaps and the poses were kept"
    return f"{record.directions} of the six numbers are determined; they {told} ({record.sigma:.1f} sd)."
