"""The options that ``recon run`` and ``recon batch`` have in common, each with its help."""

import math
from pathlib import Path
from typing import Annotated

import typer

from recon.method import Limits, Method, ThinForm

DEFAULT = Limits()

MethodOption = Annotated[
    Method, typer.Option(help="paper: as published; full: maximum likelihood, with uncertainties.")
]
SmallestAngle = Annotated[
    float, typer.Option(min=0.0, max=90.0, help="Method paper: smallest angle between the two light paths, degrees.")
]
LargestGapShare = Annotated[
    float,
    typer.Option(min=0.0, help="Method paper: largest gap between the paths, as a share of the displays' distance."),
]
GapSigma = Annotated[float, typer.Option(min=0.0, help="Method full: largest gap in standard deviations.")]
AngleSigma = Annotated[float, typer.Option(min=0.0, help="Method full: smallest angle in standard deviations.")]
CalibrationFile = Annotated[
    Path | None,
    typer.Option(
        help="Calibration of the rig, whose poses replace the manifest's. [default: SESSION/calibration.json, if it is there]"
    ),
]
RegistrationSwitch = Annotated[
    bool,
    typer.Option(
        help="Method full: correct how the display slipped in its plane between air and liquid, as the gaps between "
        "the light paths tell it."
    ),
]
BoardSwitch = Annotated[
    bool,
    typer.Option(
        "--board/--no-board",
        help="Measure the display's pose in each set by the session's photos of a board, if it has any.",
    ),
]
IntegrationOption = Annotated[
    ThinForm | None,
    typer.Option(
        help="Thin objects: how normals become a surface. fused: together with the triangulated points; the others take the "
        "normals alone: quadratic: least squares; discrete: as published; bilateral: keeps jumps of depth. "
        "[default: quadratic; discrete for method paper]",
        show_default=False,
    ),
]
ForceSwitch = Annotated[bool, typer.Option("--force", help="Make everything anew, whatever earlier runs have kept.")]


def limits_of(*, smallest_angle_deg: float, largest_gap_share: float, gap_sigma: float, angle_sigma: float) -> Limits:
    """Return the tests that a point must pass, as the options give them."""
    return Limits(
        smallest_angle_rad=math.radians(smallest_angle_deg),
        largest_gap_share=largest_gap_share,
        gap_sigma=gap_sigma,
        angle_sigma=angle_sigma,
    )
