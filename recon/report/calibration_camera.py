"""The camera's part of a calibration's page: how well each view fits, what the views cover, and the lens with its uncertainty."""

import cv2
import numpy as np
from jaxtyping import Float64

from recon.calibration.calibration_file import CalibratedCamera, Calibration
from recon.calibration.evidence import SeenView
from recon.calibration.lens import LENS_NAMES, camera_matrix, lens_numbers, view_rays
from recon.report.charts import Scale
from recon.report.numbers import number, plus_minus
from recon.report.panel import Panel, Section, Table
from recon.report.photo_cells import WIDTH, add_arrows, add_square, cell_centres, empty_grid, squares

CHART_HEIGHT, LEFT, RIGHT, BOTTOM = 230, 48, 10, 40
WORST = 5
NOT_KEPT = "This calibration was written without it; calibrate again to see it."
LENS_WORDS = (
    ("Focal length across", "px"),
    ("Focal length down", "px"),
    ("Picture centre across", "px"),
    ("Picture centre down", "px"),
    ("Radial distortion k1", ""),
    ("Radial distortion k2", ""),
    ("Tangential distortion p1", ""),
    ("Tangential distortion p2", ""),
    ("Radial distortion k3", ""),
)


def camera_section(calibration: Calibration) -> Section:
    """Return how well the views of the board fix the lens."""
    return Section(
        "camera",
        "The camera",
        (
            views_panel(calibration),
            coverage_panel(calibration),
            residual_panel(calibration),
            distortion_panel(calibration.camera),
            certainty_panel(calibration.camera),
            lens_panel(calibration.camera),
        ),
    )


def views_panel(calibration: Calibration) -> Panel:
    """Return the residual of each photo of the board, worst ones named."""
    evidence = calibration.evidence
    views = (*evidence.lens_views, *evidence.display_views) if evidence else ()
    data: dict[str, object] = {}
    if views:
        ranked = sorted(views, key=lambda each: each.rms_px, reverse=True)[:WORST]
        rows = tuple(
            (each.name, shows(each), f"{number(each.rms_px, 2)} px", f"{each.corners - each.corners_dropped}")
            for each in ranked
        )
        highest = max(each.rms_px for each in views)
        y = Scale(0.0, 1.08 * highest, CHART_HEIGHT - BOTTOM, 6)
        step = (WIDTH - LEFT - RIGHT) / len(views)
        data = {
            "size": (WIDTH, CHART_HEIGHT, LEFT, RIGHT, BOTTOM),
            "bars": [
                (
                    round(LEFT + (k + 0.12) * step, 2),
                    y.place(each.rms_px),
                    round(0.76 * step, 2),
                    "off" if each.disagrees else "shown" if each.pose else "held",
                    f"{each.name}: {number(each.rms_px, 2)} px",
                )
                for k, each in enumerate(views)
            ],
            "y_ticks": y.ticks(4),
            "both": bool(evidence and evidence.lens_views and evidence.display_views),
            "table": Table(("Worst photos", "Board", "rms", "Corners"), rows, (2, 3)),
        }
    off = [each.name for each in views if each.disagrees]
    return Panel(
        "views",
        "How well each photo fits",
        "view_bars.html.j2",
        data,
        "Root mean square distance between the corners as photographed and as the calibration predicts them, photo by photo, in "
        "the order in which they were given.",
        "Bars of about one height, well below a tenth of a pixel for a sharp photo.",
        f"Bars that stand out, in red: {', '.join(off)}. Shaken, or the board bent: leave them out and take others."
        if off
        else "A bar that stands out: that photo was shaken, or its board was bent. Leave it out and take another.",
        missing="" if views else NOT_KEPT,
    )


def shows(view: SeenView) -> str:
    """Return where the board of a view was."""
    if not view.pose:
        return "held"
    if not view.pose.startswith("pos"):
        return "display, oblique"
    return f"display {view.pose[3]}, {'wet' if view.pose.endswith('liquid') else 'dry'}"


def coverage_panel(calibration: Calibration) -> Panel:
    """Return how many corners lie in each part of the photo."""
    camera, cells = calibration.camera, calibration.evidence.cells if calibration.evidence else ()
    drawing = empty_grid(camera)
    if cells:
        most = max(cell.corners for row in cells for cell in row)
        for square, cell in zip(squares(camera), (cell for row in cells for cell in row), strict=True):
            add_square(drawing, square, cell.corners / max(most, 1), number(cell.corners), empty=cell.corners == 0)
    drawing["label"] = "Number of corners in each part of the photo"
    return Panel(
        "coverage",
        "What the views cover",
        "picture_grid.html.j2",
        drawing,
        "The photo in equal parts, and how many corners of the held board fell in each.",
        "Corners everywhere, right into the corners of the photo.",
        "Hatched parts, without a corner: the lens is guessed there. Hold the board there.",
        missing="" if cells else NOT_KEPT,
        wide=False,
    )


def residual_panel(calibration: Calibration) -> Panel:
    """Return the mean residual in each part of the photo as arrows."""
    camera, cells = calibration.camera, calibration.evidence.cells if calibration.evidence else ()
    drawing = empty_grid(camera)
    if cells:
        flat = [cell for row in cells for cell in row]
        shift = np.array([[cell.residual_x_px, cell.residual_y_px] for cell in flat])
        for square, cell in zip(squares(camera), flat, strict=True):
            add_square(drawing, square, 0.0, "", empty=cell.corners == 0)
        add_arrows(drawing, camera, shift, whole_px=camera.rms_px)
    drawing["label"] = "Mean residual in each part of the photo, as arrows"
    return Panel(
        "residuals",
        "What the lens model leaves",
        "picture_grid.html.j2",
        drawing,
        "The mean of measured less predicted place over the corners of each part. An arrow as long as a part is high would be as "
        "long as the error of a single corner.",
        "Short arrows that point anywhere: noise, averaged.",
        "Arrows that turn or spread in a pattern: the lens has a distortion that the model does not, or the board is not flat.",
        missing="" if cells else NOT_KEPT,
        wide=False,
    )


def distortion_panel(camera: CalibratedCamera) -> Panel:
    """Return by how much the lens displaces each part of the picture."""
    lens = lens_numbers(camera.intrinsics)
    place_px = cell_centres(camera)
    rays = view_rays(place_px, lens)
    straight_px = rays[:, :2] / rays[:, 2:] * lens[:2] + lens[2:4]
    drawing = empty_grid(camera)
    for square in squares(camera):
        add_square(drawing, square, 0.0, "")
    add_arrows(drawing, camera, place_px - straight_px)
    drawing["label"] = "Displacement of each part of the photo by the lens, as arrows"
    return Panel(
        "distortion",
        "What the lens does",
        "picture_grid.html.j2",
        drawing,
        "Arrows from where a lens without distortion would show a point to where this one shows it.",
        "Smooth, and about symmetric to the middle of the picture.",
        "Arrows that grow suddenly in a corner: no view of the board reached it.",
        wide=False,
    )


def certainty_panel(camera: CalibratedCamera) -> Panel:
    """Return how well each part of the picture is known, after the best turn of the camera as a whole."""
    sd_px = direction_sd_px(camera)
    most_px = float(sd_px.max())
    drawing = empty_grid(camera)
    for square, sd in zip(squares(camera), sd_px, strict=True):
        add_square(drawing, square, float(sd) / (most_px or 1.0), number(float(sd), 2))
    drawing["label"] = "Standard deviation of each part of the photo, in pixels"
    return Panel(
        "certainty",
        "How well it is known",
        "picture_grid.html.j2",
        drawing,
        "Standard deviation in px of where the lens shows a direction, after the best turn of the camera as a whole, which "
        "carries display and object along.",
        "A few hundredths of a pixel, a tenth in the corners.",
        "Tenths of a pixel where the display is seen: take more views there.",
        missing="" if most_px > 0 else "The file has no covariance of the lens.",
        wide=False,
    )


def lens_panel(camera: CalibratedCamera) -> Panel:
    """Return the nine numbers of the lens."""
    values = lens_numbers(camera.intrinsics)
    sd = np.sqrt(np.diag(np.array(camera.covariance, dtype=np.float64)))
    rows = tuple(
        (words, f"{plus_minus(float(value), float(each))} {unit}".strip())
        for (words, unit), value, each in zip(LENS_WORDS, values, sd, strict=True)
    )
    return Panel(
        "lens",
        "The lens in numbers",
        "table.html.j2",
        {"table": Table(("Number", "Value ± sd"), rows)},
        f"{camera.model or 'The camera'}, photos of {camera.columns} × {camera.rows} px, {camera.views} views of the board. "
        "The nine numbers are not independent of each other; their covariance is in calibration.json.",
    )


def direction_sd_px(camera: CalibratedCamera) -> Float64[np.ndarray, " cells"]:
    """Return the sd of the photo's place of a direction in the middle of each cell, both axes together, px.

    The lens's covariance is taken through the derivative of the place, off which the turn of the camera that explains most of it
    is taken (all cells alike): a turned camera is no fault of the lens.
    """
    lens = lens_numbers(camera.intrinsics)
    rays = view_rays(cell_centres(camera), lens)
    nothing = np.zeros(3)
    jacobian = cv2.projectPoints(rays / rays[:, 2:], nothing, nothing, camera_matrix(lens), lens[4:])[1]
    by_turn, by_lens = jacobian[:, :3], jacobian[:, 6 : 6 + len(LENS_NAMES)]
    left = by_lens - by_turn @ np.linalg.lstsq(by_turn, by_lens, rcond=None)[0]
    variance = np.einsum("in,nm,im->i", left, np.array(camera.covariance, dtype=np.float64), left)
    return np.sqrt(np.maximum(variance, 0.0).reshape(-1, 2).sum(axis=1))
