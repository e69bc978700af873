"""Write the report page of a geometric calibration: verdict, what its errors mean at the object, then camera, display, photos."""

from datetime import datetime, timedelta
from pathlib import Path

from recon.calibration.calibration_file import Calibration
from recon.calibration.errors import CalibrationError
from recon.calibration.wet_pose import WET_PANELS
from recon.metrics import Verdict
from recon.report.calibration_camera import camera_section
from recon.report.calibration_display import display_section
from recon.report.numbers import NOTHING, number
from recon.report.page import render_page
from recon.report.panel import Banner, Panel, Section, Table
from recon.sessions.disk import write_fault

CALIBRATION_PAGE_NAME = "calibration.html"
# What a calibration may add to the shape of an object, and beyond what no capture is worth its time: ten times as much.
GOAL_SHAPE_MM = 0.02
USELESS_SHAPE_MM = 0.2
ADD_TO_CONFIGURATION = 'name it in the configuration (`calibration = "…/calibration.json"`) and capture.'


def calibration_verdict(calibration: Calibration) -> Verdict:
    """Return pass where nothing is left to do, fail where no capture would be worth its time, else check."""
    quality = calibration.quality
    reasons = [sentence[0].upper() + sentence[1:] + _stop(sentence) for sentence in calibration.warnings]
    shape_mm = quality.fep_shape_error_mm
    if shape_mm is not None and shape_mm > GOAL_SHAPE_MM:
        wet = any(name in calibration.poses for name in WET_PANELS)
        more = "photos of the board under liquid" if wet else "views of the board"
        reasons.insert(
            0,
            f"The calibration alone would deform the object by {number(shape_mm, 2)} mm (goal: {number(GOAL_SHAPE_MM, 1)} mm); "
            f"more {more} make it less.",
        )
    if shape_mm is not None and shape_mm > USELESS_SHAPE_MM:
        return Verdict(
            grade="fail",
            reasons=tuple(reasons),
            next_action="look at the worst views below, photograph the board again, sharp and evenly lit, and calibrate again.",
        )
    if not reasons:
        return Verdict(grade="pass", reasons=(), next_action=ADD_TO_CONFIGURATION)
    return Verdict(
        grade="check",
        reasons=tuple(reasons),
        next_action=f"mend what is named and calibrate again; or, if you can live with it, {ADD_TO_CONFIGURATION}",
    )


def holds_until(calibration: Calibration) -> str:
    """Return the last day on which the calibration holds; a dash where its date is not known."""
    try:
        last = datetime.fromisoformat(calibration.created) + timedelta(days=calibration.valid_days)
    except ValueError:
        return NOTHING
    return f"{last.day} {last:%B %Y}"


def calibration_tiles(calibration: Calibration) -> tuple[tuple[str, str, str], ...]:
    """Return the few numbers that an operator looks for first."""
    quality = calibration.quality
    return (
        ("Shape of the object", _with(quality.fep_shape_error_mm, " mm"), "rms that the calibration adds"),
        ("Normals", _with(quality.normal_error_deg, "°"), "rms that the calibration adds"),
        ("Corners", f"{number(quality.reprojection_rms_px)} px", f"rms of {number(quality.corners)} on the display"),
        ("Holds until", holds_until(calibration), f"{calibration.valid_days:g} days, or until something moves"),
    )


def object_panel(calibration: Calibration) -> Panel:
    """Return what the calibration's uncertainty means for points and normals."""
    quality = calibration.quality
    rows = (
        (
            "Shape",
            _with(quality.fep_shape_error_mm, " mm"),
            "How far points are off once the object as a whole is laid over the true one. "
            "Radii, flatness, thickness: what a measurement of the object suffers.",
        ),
        (
            "Place, seen from the display",
            _with(quality.fep_display_error_mm, " mm"),
            "How far the object as a whole is off in the frame of the display at position 0, dry.",
        ),
        (
            "Place, seen from the camera",
            _with(quality.fep_error_mm, " mm"),
            "The same in the camera's frame. Most of it is an error that all four sets share: focal length and picture centre "
            "carry display and object along together. It changes no shape.",
        ),
        ("Normals", _with(quality.normal_error_deg, "°"), "How far the directions of the surface are off."),
    )
    return Panel(
        "object",
        "",
        "meanings.html.j2",
        {"rows": rows},
        "What the uncertainty of this calibration alone does to an object of the usual size and place, as rms. "
        "Noise of the photos comes on top; the report of each reconstruction tells it.",
        f"A shape error of {number(GOAL_SHAPE_MM, 1)} mm or less, and normals to a few hundredths of a degree.",
        "A shape error as large as what you want to measure: take more views, and more photos of the board on the display.",
        missing="" if quality.fep_error_mm is not None else "This calibration does not say it.",
    )


def provenance_section(calibration: Calibration) -> Section:
    """Return which devices, settings, versions and photos the numbers come from."""
    source = calibration.provenance
    rows = [("Made", calibration.created), ("Holds until", holds_until(calibration))]
    rows += [
        (f"Device: {name}", f"{each.model} ({each.kind}) {each.address}".strip())
        for name, each in source.devices.items()
    ]
    rows += [(f"Setting: {name}", value) for name, value in calibration.camera.settings.items()]
    rows += [(f"Version: {name}", value) for name, value in source.software.items()]
    if source.note:
        rows.append(("Note", source.note))
    board = calibration.board
    if board is not None:
        rows.append(
            (
                "Board",
                f"{board.squares_x} × {board.squares_y} squares of {number(board.square_mm, 4)} mm, "
                f"{board.dictionary}, layout {board.layout}",
            )
        )
    made = Panel(
        "provenance",
        "Devices, settings and board",
        "table.html.j2",
        {"table": Table(("What", "Which"), tuple(rows))},
        "A calibration belongs to these devices and settings. After a change of lens, focus, aperture, photo size or mounting it "
        "is made again.",
        "The devices and settings of the captures that it is used for.",
        "Another focus or aperture than the captures have; a rig that was moved since.",
    )
    photos = Panel(
        "hashes",
        "Photos",
        "table.html.j2",
        {
            "table": Table(
                ("Photo", "Shows", "SHA-256"),
                tuple((each.file, each.shows or NOTHING, each.sha256) for each in source.photos),
            )
        },
        "All that took part, with their hashes.",
        missing="" if source.photos else "This calibration names no photos.",
    )
    return Section("provenance", "Where it comes from", (made, photos))


def write_calibration_page(path: Path, calibration: Calibration) -> None:
    """Write the page; raises ``CalibrationError`` where that cannot be done."""
    simulated = sorted({each.kind for each in calibration.provenance.devices.values()} - {"real"})
    banners: tuple[Banner, ...] = ()
    if simulated:
        banners = (Banner("Not a real rig.", f"Devices were {' and '.join(simulated)}.", True),)
    page = render_page(
        "Where the camera looks, and where the display stands",
        kind="Geometric calibration",
        subtitle=f"measured {calibration.created[:16].replace('T', ', ')} UTC",
        sections=(
            Section("object", "What it means at the object", (object_panel(calibration),)),
            camera_section(calibration),
            display_section(calibration),
            provenance_section(calibration),
        ),
        banners=banners,
        verdict=calibration_verdict(calibration),
        tiles=calibration_tiles(calibration),
    )
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise CalibrationError(write_fault(path, error)) from error


def _with(value: float | None, unit: str) -> str:
    return NOTHING if value is None else f"{number(value, 2)}{unit}"


def _stop(sentence: str) -> str:
    return "" if sentence.endswith((".", "?", "!")) else "."
