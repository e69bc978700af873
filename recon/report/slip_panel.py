"""Whether the display slipped between dry and wet, by its calibration: a drawing and a table of each position."""

import numpy as np
from scipy.special import chdtri

from recon.calibration.calibration_file import Calibration
from recon.calibration.display_motion import slips_of
from recon.calibration.wet_pose import Slip
from recon.report.charts import Scale, line_path, round_up
from recon.report.numbers import plus_minus
from recon.report.panel import Panel, Table

SLIP_SIZE, SLIP_EDGE, SLIP_TOP = 260, 42, 18
CHANCE = 0.95
NOT_WET = "The display was not photographed under liquid; its dry poses count for all four sets."


def slip_panel(calibration: Calibration) -> Panel:
    """Return how the display moved between dry and wet, with its uncertainty."""
    found = slips_of(calibration)
    rows = []
    for slip in found:
        sd = np.sqrt(np.diag(slip.covariance))
        rows.append(
            (
                f"Position {slip.position}",
                f"{plus_minus(float(slip.moved[3]), float(sd[3]))} mm",
                f"{plus_minus(float(slip.moved[4]), float(sd[4]))} mm",
                f"{plus_minus(float(np.degrees(slip.moved[2])), float(np.degrees(sd[2])))}°",
                f"{plus_minus(float(slip.moved[5]), float(sd[5]))} mm" if slip.determined[5] else "taken as small",
                "yes" if slip.found() else "no",
            )
        )
    headings = ("", "Right", "Down", "Turn in its plane", "Away from the camera", "Slipped?")
    return Panel(
        "slips",
        "Whether it slipped between dry and wet",
        "slips.html.j2",
        {"charts": [slip_chart(slip) for slip in found], "table": Table(headings, tuple(rows), (1, 2, 3, 4))},
        "Where the display stood under liquid, seen from where it stood dry (the cross), in its own plane. The truth lies in the "
        "ellipse with a chance of 95 %.",
        "The cross lies in the ellipse, or a few hundredths of a millimetre beside it.",
        "A slip of tenths of a millimetre: uncorrected, it turns normals by degrees. Its measured pose is used; fasten the "
        "display all the same.",
        missing="" if found else NOT_WET,
    )


def slip_chart(slip: Slip) -> dict[str, object]:
    """Return the drawing of one slip: right and down in mm, the same scale for both, with the 95 % ellipse."""
    values, vectors = np.linalg.eigh(slip.covariance[3:5, 3:5])
    reach = float(np.sqrt(chdtri(2, 1 - CHANCE)))
    radii_mm = reach * np.sqrt(np.maximum(values, 0.0))
    limit_mm = round_up(1.15 * float(np.abs(slip.moved[3:5]).max() + radii_mm.max()))
    x = Scale(-limit_mm, limit_mm, SLIP_EDGE, SLIP_SIZE - SLIP_TOP)
    y = Scale(-limit_mm, limit_mm, SLIP_TOP, SLIP_SIZE - SLIP_EDGE)
    turn = np.linspace(0, 2 * np.pi, 49)
    edge = (
        slip.moved[3:5]
        + np.outer(np.cos(turn), radii_mm[0] * vectors[:, 0])
        + np.outer(np.sin(turn), radii_mm[1] * vectors[:, 1])
    )
    return {
        "title": f"Position {slip.position}",
        "size": (SLIP_SIZE, SLIP_EDGE, SLIP_TOP),
        "ellipse": line_path(x, y, [(float(a), float(b)) for a, b in edge]) + "Z",
        "dot": (x.place(float(slip.moved[3])), y.place(float(slip.moved[4]))),
        "cross": (x.place(0.0), y.place(0.0)),
        "found": slip.found(),
        "x_ticks": [(x.place(value), f"{value:g}".replace("-", "−")) for value in (-limit_mm, 0.0, limit_mm)],
        "y_ticks": [(y.place(value), f"{value:g}".replace("-", "−")) for value in (-limit_mm, 0.0, limit_mm)],
    }
