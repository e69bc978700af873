"""Where the display stood in this very session, as its own photos of a board say, and whether it slipped."""

from recon.metrics import BoardResult, Metrics
from recon.report.numbers import NOTHING, LengthUnit, number
from recon.report.panel import Panel, Table


def board_panel(metrics: Metrics, unit: LengthUnit) -> Panel:
    """Return the slips and the corners that they come from, or why nothing was measured."""
    board = metrics.board
    return Panel(
        "board",
        "Display measured again in this session",
        "tables.html.j2",
        {"tables": () if board is None else (_slips(board, unit), _corners(board))},
        ""
        if board is None
        else f"{_text(board)} Known before: {board.source}. The poses above are those of these photos.",
        "Shifts of the order of their standard deviations, and corners to less than a tenth of a photo pixel.",
        "A shift of many standard deviations: it is corrected, but a display that slips once may slip during a sweep as well; "
        "fasten it. Few corners used, or all on one side of the object: the board is too coarse, or the object hides it.",
        missing="" if board is not None else metrics.board_note or "The run did not look for photos of a board.",
    )


def _text(board: BoardResult) -> str:
    return " ".join(f"{sentence[0].upper()}{sentence[1:]}." for sentence in board.sentences)


def _slips(board: BoardResult, unit: LengthUnit) -> Table:
    rows = tuple(
        (
            f"position {slip.position}",
            _with_sd(slip.in_plane_mm, slip.in_plane_sd_mm),
            _with_sd(slip.turn_deg, slip.turn_sd_deg),
            _with_sd(slip.along_normal_mm, slip.along_normal_sd_mm),
            number(slip.sigma),
            "slipped; corrected" if slip.found else "where it was",
        )
        for slip in board.slips
    )
    headings = ("In liquid", f"Shift in its plane ({unit.label})", "Turn (°)", f"Shift along its normal ({unit.label})")
    return Table((*headings, "Standard deviations", "The display"), rows, (1, 2, 3, 4))


def _corners(board: BoardResult) -> Table:
    rows = tuple(
        (
            one.set,
            number(one.photos),
            number(one.found),
            number(one.through_object),
            number(one.used),
            NOTHING if one.rms_px is None else number(one.rms_px),
        )
        for one in board.sets
    )
    headings = ("Set", "Photos", "Corners found", "Left out: through the object", "Used", "Misfit, RMS (px)")
    return Table(headings, rows, (1, 2, 3, 4, 5))


def _with_sd(value: float, sd: float) -> str:
    return f"{number(value)} ± {number(sd, 2)}"
