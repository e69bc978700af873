"""The display's part of a calibration's page: where it stands, how straight it went, whether it slipped, its pitch and glass."""

import numpy as np
from jaxtyping import Float64
from scipy.stats import chi2

from recon.calibration.calibration_file import Calibration
from recon.calibration.display_poses import AIR_PANELS, STRAIGHT_SIGMA, Straightness, panel_pose, straightness_between
from recon.calibration.lens import lens_numbers, view_rays
from recon.calibration.sight_line import PanelPose
from recon.calibration.wet_pose import WET_PANELS, Slip, slip_between
from recon.report.charts import Scale, line_path, round_up
from recon.report.numbers import number
from recon.report.panel import Panel, Section, Table
from recon.report.response_section import plus_minus

WIDTH, MOST_HEIGHT, AXIS_HEIGHT = 760, 330, 46
SLIP_SIZE, SLIP_EDGE, SLIP_TOP = 260, 42, 18
CHANCE = 0.95
NOT_WET = "The display was not photographed under liquid; its dry poses count for all four sets."


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


def panels_of(calibration: Calibration) -> dict[str, PanelPose]:
    """Return the display's poses by set."""
    return {name: panel_pose(pose) for name, pose in calibration.poses.items()}


def covariance_of(calibration: Calibration, *names: str) -> Float64[np.ndarray, "numbers numbers"]:
    """Return the joint covariance of the poses of these sets."""
    order = list(calibration.poses)
    chosen = np.concatenate([6 * order.index(name) + np.arange(6) for name in names])  # type: ignore[arg-type]  # set names
    return calibration.pose_covariance()[np.ix_(chosen, chosen)]


def straightness_of(calibration: Calibration) -> Straightness | None:
    """Return how straight the stage carried the display; None where the file has no covariance."""
    if not calibration.covariance:
        return None
    panels = panels_of(calibration)
    first, second = (panels[name] for name in AIR_PANELS)
    return straightness_between(first, second, covariance_of(calibration, *AIR_PANELS))


def slips_of(calibration: Calibration) -> tuple[Slip, ...]:
    """Return how the display moved between dry and wet at each position that was photographed wet."""
    panels = panels_of(calibration)
    return tuple(
        slip_between(position, panels[dry], panels[wet], covariance_of(calibration, dry, wet))
        for position, (dry, wet) in enumerate(zip(AIR_PANELS, WET_PANELS, strict=True))
        if wet in panels and calibration.covariance
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
    reach = float(np.sqrt(chi2.ppf(CHANCE, 2)))
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
