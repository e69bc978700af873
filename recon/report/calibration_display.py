"""The display's part of a calibration's page: where it stands, how straight it went, whether it slipped, its pitch and glass."""

import numpy as np

from recon.calibration.calibration_file import Calibration
from recon.calibration.display_motion import panels_of, straightness_of
from recon.calibration.display_poses import AIR_PANELS, STRAIGHT_SIGMA
from recon.calibration.lens import lens_numbers, view_rays
from recon.calibration.wet_pose import WET_PANELS
from recon.report.charts import Scale, line_path
from recon.report.numbers import number, plus_minus
from recon.report.panel import Panel, Section, Table
from recon.report.slip_panel import slip_panel

WIDTH, MOST_HEIGHT, AXIS_HEIGHT = 760, 330, 46


def display_section(calibration: Calibration) -> Section:
    """Return where the display stands, and how well that is known."""
    return Section(
        "display",
        "The display",
        (
            side_panel(calibration),
            travel_panel(calibration),
            slip_panel(calibration),
            poses_panel(calibration),
            panel_panel(calibration),
        ),
    )


def side_panel(calibration: Calibration) -> Panel:
    """Return camera, liquid and display seen from the side, to scale."""
    return Panel(
        "side",
        "The arrangement, to scale",
        "rig_side.html.j2",
        side_view(calibration),
        "Seen from the camera's left-hand side: the camera on the left, up is the top of its picture. A photo shows what "
        "lies between the thin lines.",
        "Display and liquid stand where you remember them, and position 1 lies on the side to which the stage went.",
        "A display that leans or stands elsewhere than you remember: a wrong board size, or a wrong pitch.",
    )


def side_view(calibration: Calibration) -> dict[str, object]:
    """Return the drawing's parts: distance from the camera across, height up, one scale for both."""
    display, camera = calibration.display, calibration.camera
    half_mm = 0.5 * np.array([display.columns, display.rows]) * display.pitch_mm
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    panels = panels_of(calibration)
    corners = {name: pose.centre_mm + (signs * half_mm) @ pose.rotation[:, :2].T for name, pose in panels.items()}
    farthest_mm = max(float(each[:, 2].max()) for each in corners.values())
    middle_px = (camera.columns - 1) / 2
    edges = view_rays(np.array([[middle_px, 0.0], [middle_px, camera.rows - 1.0]]), lens_numbers(camera.intrinsics))
    sight = [(0.0, 0.0), *((farthest_mm, -float(ray[1] / ray[2]) * farthest_mm) for ray in edges)]
    up = [-y for each in corners.values() for y in each[:, 1]] + [place for _, place in sight]
    room_mm = 0.05 * (max(up) - min(up))
    across_mm, up_mm = farthest_mm + 4 * room_mm, max(up) - min(up) + 4 * room_mm
    scale = min((WIDTH - 16) / across_mm, MOST_HEIGHT / up_mm)
    height = round(scale * up_mm) + AXIS_HEIGHT
    left = (WIDTH - scale * across_mm) / 2
    x = Scale(-2 * room_mm, farthest_mm + 2 * room_mm, left, WIDTH - left)
    y = Scale(min(up) - room_mm, max(up) + 3 * room_mm, height - AXIS_HEIGHT, 0)
    outline = {name: line_path(x, y, [(c[2], -c[1]) for c in (*each, each[0])]) for name, each in corners.items()}
    liquid, label = "", None
    level = calibration.level
    if level is not None:
        down = np.array(level.down)
        ends = [(float((level.distance_mm + down[1] * place) / down[2]), place) for place in (min(up), max(up))]
        liquid = line_path(x, y, ends)
        label = (x.place(ends[1][0]) - 5, y.place(max(up)), f"liquid, index {number(level.n, 4)}")
    return {
        "size": (WIDTH, height),
        "sight": line_path(x, y, [sight[1], sight[0], sight[2]]),
        "dry": [outline[name] for name in AIR_PANELS],
        "wet": [outline[name] for name in WET_PANELS if name in outline],
        "labels": [
            (x.place(float(corners[name][:, 2].mean())), y.place(float(-corners[name][:, 1].min())) - 6, place)
            for place, name in enumerate(AIR_PANELS)
        ],
        "camera": (x.place(0.0), y.place(0.0)),
        "liquid": liquid,
        "liquid_label": label,
        "ticks": x.ticks(7),
    }


def travel_panel(calibration: Calibration) -> Panel:
    """Return how far and how straight the stage carried the display."""
    found = straightness_of(calibration)
    rows: tuple[tuple[str, str], ...] = ()
    said = ""
    if found is not None:
        said = found.sentence()
        rows = (
            ("From position 0 to position 1", f"{plus_minus(found.travel_mm, found.travel_sd_mm)} mm"),
            ("Turned on the way", f"{plus_minus(np.degrees(found.turn_rad), np.degrees(found.turn_sd_rad))}°"),
            (
                "How sure that it turned at all",
                f"{number(found.sigma, 2)} sd; called crooked beyond {number(STRAIGHT_SIGMA, 1)}",
            ),
            ("Its face to the way it goes", f"{number(float(np.degrees(found.lean_rad)), 2)}° from upright; no fault"),
        )
    return Panel(
        "travel",
        "How straight the stage carries it",
        "table.html.j2",
        {"table": Table(("Travel", "Value ± sd"), rows)},
        said[:1].upper() + said[1:] + ("." if said else ""),
        "A distance that is the stage's own, and no turn that is sure.",
        "A turn of more than 3 sd: a loose carriage, or a display that hangs over. It is measured, so results stay right while "
        "it does so every time.",
        missing="" if found else "The file has no covariance of the poses, so nothing tells a turn from noise.",
    )


def poses_panel(calibration: Calibration) -> Panel:
    """Return centre and axes of the display in each set, with standard deviations."""
    sd = np.sqrt(np.diag(calibration.pose_covariance())).reshape(-1, 6)
    rows = []
    for (name, pose), each in zip(calibration.poses.items(), sd, strict=True):
        centre = ", ".join(plus_minus(value, float(one)) for value, one in zip(pose.centre_mm, each[3:], strict=True))
        axes = [", ".join(number(float(value), 5) for value in axis) for axis in (pose.x_axis, pose.y_axis)]
        turn = f"{number(float(np.degrees(np.sqrt((each[:3] ** 2).sum()))), 2)}°"
        rows.append((name, centre, *axes, turn))
    return Panel(
        "poses",
        "Poses",
        "table.html.j2",
        {
            "table": Table(
                ("Set", "Centre (mm)", "x axis (right)", "y axis (down)", "Sd of its direction"), tuple(rows), (4,)
            )
        },
        "In the camera's frame: x right, y down, z forward. Most of the uncertainty of the centres is one that all sets share.",
    )


def panel_panel(calibration: Calibration) -> Panel:
    """Return pitch, cover glass and liquid, measured or taken as given."""
    display, quality = calibration.display, calibration.quality
    pitch = f"{number(display.pitch_mm, 6)} mm, taken as given"
    if quality.pitch_sd_share is not None:
        pitch = f"{plus_minus(display.pitch_mm, display.pitch_mm * quality.pitch_sd_share)} mm, measured"
    glass = "none stated"
    if display.cover_glass is not None:
        thickness_mm, sd_mm = display.cover_glass.thickness_mm, quality.cover_glass_sd_mm
        known = (
            f"{number(thickness_mm)} mm, taken as given"
            if sd_mm is None
            else f"{plus_minus(thickness_mm, sd_mm)} mm, measured"
        )
        glass = f"{known}; index {number(display.cover_glass.n, 4)}"
    rows = [("Panel", f"{display.columns} × {display.rows} pixels"), ("Pitch", pitch), ("Cover glass", glass)]
    level = calibration.level
    if level is not None:
        lean_deg = float(np.degrees(np.arccos(np.clip(level.down[2] / np.linalg.norm(level.down), -1, 1))))
        rows.append(
            (
                "Liquid's surface",
                f"{number(level.distance_mm, 5)} mm from the camera, {number(lean_deg, 2)}° from square to its axis; index "
                f"{number(level.n, 5)}",
            )
        )
    return Panel(
        "panel",
        "Pitch, cover glass and liquid",
        "table.html.j2",
        {"table": Table(("What", "Value"), tuple(rows))},
        "A pitch that is off scales the whole object; glass that is left out displaces it by two thirds of its thickness and "
        "bends its shape.",
        "A pitch within a few ten-thousandths of the maker's; a glass that is as thick as such glass is (0.5 to 2 mm).",
        "A pitch off by a per cent (another display, or a browser that scales).",
    )
