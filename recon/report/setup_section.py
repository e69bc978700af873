"""What was known before the reconstruction: where the display stood, what it is, the liquid, the camera."""

import numpy as np
from jaxtyping import Float64

from recon.calibration.calibration_file import Calibration
from recon.calibration.display_motion import slips_of
from recon.maps import Maps
from recon.metrics import Metrics
from recon.report.board_panel import board_panel
from recon.report.calibration_page import CALIBRATION_PAGE_NAME, holds_until
from recon.report.charts import Scale, line_path
from recon.report.display_frame import frame_from_world, screen_corners, transform_points
from recon.report.numbers import NOTHING, LengthUnit, number
from recon.report.panel import Panel, Section, Table
from recon.report.point_scene import SEED, box_of
from recon.sessions.manifest import Manifest, Pose
from recon.sessions.pattern import GrayLinePattern, Pattern, PhaseShiftPattern

DRAWING_WIDTH = 720
AXIS_HEIGHT = 46
DOTS = 1500
# A camera farther off than this many times the rest of the scene is drawn as an arrow with its distance.
FAR_CAMERA = 1.5


def between_axes_deg(first: Pose, second: Pose) -> float:
    """Return the angle between two screens, in degrees."""
    cosine = first.world_from_screen()[:3, 2] @ second.world_from_screen()[:3, 2]
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _vector(values: tuple[float, float, float], digits: int = 4) -> str:
    return "(" + ", ".join(number(float(value), digits) for value in values) + ")"


def poses_panel(manifest: Manifest, unit: LengthUnit) -> Panel:
    """Return where the display stood, and how its places differ."""
    named = [(f"position {place}", pose) for place, pose in enumerate(manifest.display_poses)]
    named += [(f"{each.name}, measured again", each.pose) for each in manifest.sets if each.pose is not None]
    rows = tuple((name, _vector(pose.centre_mm), _vector(pose.x_axis), _vector(pose.y_axis)) for name, pose in named)
    first, second = manifest.display_poses
    apart = float(np.linalg.norm(np.subtract(second.centre_mm, first.centre_mm)))
    angle_deg = between_axes_deg(first, second)
    table = Table(("Display at", f"Centre ({unit.label})", "x axis (right)", "y axis (down)"), rows)
    return Panel(
        "poses",
        "Display poses",
        "table.html.j2",
        {"table": table},
        f"The two positions stand {number(apart)} {unit.label} apart and are tilted by {number(angle_deg)}° to each other.",
        "The distance is that of the stage's move and the tilt is what the stage's rails allow (well below a degree).",
        "A distance that does not match the stage, or a display measured again that moved by more than its pixel pitch.",
    )


def parts_panel(manifest: Manifest, unit: LengthUnit) -> Panel:
    """Return display, liquid, object and camera as one table."""
    display, camera = manifest.display, manifest.camera
    length = unit.label
    width, height = display.columns * display.pitch_mm, display.rows * display.pitch_mm
    rows = [
        ("Object", manifest.object.name + (f": {manifest.object.note}" if manifest.object.note else "")),
        ("Index of the object", number(manifest.object.n, 5) if manifest.object.n else "not needed by this method"),
        ("Index of the air", number(manifest.n_air, 7)),
    ]
    if manifest.liquid:
        warmth = manifest.liquid.temperature_c
        at = f" at {number(warmth)} °C" if warmth is not None else ", temperature not recorded"
        rows.append(("Liquid", f"{manifest.liquid.name}, index {number(manifest.liquid.n, 5)}{at}"))
    glass = display.cover_glass
    rows += [
        (
            "Display",
            f"{display.columns} × {display.rows} pixels of {number(display.pitch_mm, 4)} {length} "
            f"({number(width)} × {number(height)} {length}), {display.primary}",
        ),
        (
            "Cover glass",
            f"{number(glass.thickness_mm)} {length} thick, index {number(glass.n, 4)}" if glass else "none stated",
        ),
        ("Camera", f"{camera.model or 'model not recorded'}, photos of {camera.columns} × {camera.rows} pixels"),
        ("Camera's place", f"{_vector(camera.pose.centre_mm)} {length}" if camera.pose else "not calibrated"),
        ("Camera's lens", _lens(manifest)),
        ("Exposure", ", ".join(f"{k} {v}" for k, v in camera.settings.items()) or "not recorded"),
    ]
    return Panel(
        "parts",
        "Display, liquid and camera",
        "table.html.j2",
        {"table": Table(("What", "As configured or calibrated"), tuple(rows))},
        good="The liquid's index belongs to the colour of the stripe and the temperature of the tank.",
        bad="An index taken from a table for another colour: 0.01 in the index turns the normals by about 0.6°.",
    )


def _lens(manifest: Manifest) -> str:
    lens = manifest.camera.intrinsics
    if lens is None:
        return "not calibrated (this method does not need it)"
    distortion = f", distortion {len(lens.distortion)} terms" if any(lens.distortion) else ", no distortion"
    return f"focal length {number(lens.focal_x_px, 5)} × {number(lens.focal_y_px, 5)} px{distortion}"


def patterns_panel(manifest: Manifest) -> Panel:
    """Return what was shown in each sweep."""
    rows = tuple(
        (f"{each.name}, {sweep.axis}", *_shown(sweep.pattern), number(sweep.pattern.count))
        for each in manifest.sets
        for sweep in each.sweeps
    )
    headings = ("Sweep", "Shown", "Width (px)", "First place (px)", "Step (px)", "Period (px)", "Photos")
    return Panel(
        "patterns",
        "Patterns shown",
        "table.html.j2",
        {"table": Table(headings, rows, (2, 3, 4, 5, 6), "Places and widths in device pixels of the display")},
    )


def _shown(pattern: Pattern) -> tuple[str, str, str, str, str]:
    """Return what a sweep shows, and its width, first place, step and period."""
    first = number(float(pattern.first_px), 5)
    if isinstance(pattern, PhaseShiftPattern):
        periods = ", ".join(number(float(period), 4) for period in pattern.periods_px)
        return f"fringes in {pattern.steps} phases", "—", first, "—", periods
    profile = pattern.profile.replace("_", " ")
    width, step = number(float(pattern.width_px)), number(float(pattern.step_px))
    if isinstance(pattern, GrayLinePattern):
        return f"lines, {profile}, and {pattern.bits} bits", width, first, step, number(float(pattern.period_px))
    return f"stripe, {profile}", width, first, step, "—"


def drawing_panel(manifest: Manifest, maps: Maps, unit: LengthUnit) -> Panel:
    """Return the arrangement seen from the side, to scale."""
    frame = frame_from_world(manifest)
    pixels = np.random.default_rng(SEED).permutation(np.flatnonzero(maps.valid()))[: 10 * DOTS]
    cloud = transform_points(frame, maps.point_mm.reshape(-1, 3)[pixels])
    if len(cloud):
        cloud = cloud[box_of(cloud).inside(cloud)][:DOTS]
    width_mm = manifest.display.columns * manifest.display.pitch_mm
    height_mm = manifest.display.rows * manifest.display.pitch_mm
    screens = [screen_corners(frame, pose, width_mm=width_mm, height_mm=height_mm) for pose in manifest.display_poses]
    camera = None
    if manifest.camera.pose:
        camera = transform_points(frame, np.array([manifest.camera.pose.centre_mm]))[0]
    return Panel(
        "drawing",
        "The arrangement, to scale",
        "drawing.html.j2",
        side_view(screens, cloud, camera, unit),
        "Seen from the display's left-hand side: up is up, and the camera looks from the right.",
        "The points lie between display and camera, and the display reaches well beyond them.",
        "Points on or behind a display position, or a display that does not stand where you remember it.",
    )


def side_view(
    screens: list[Float64[np.ndarray, "4 3"]],
    cloud: Float64[np.ndarray, "points 3"],
    camera: Float64[np.ndarray, " 3"] | None,
    unit: LengthUnit,
) -> dict[str, object]:
    """Return the drawing's parts: distance from the display across, height up, one scale for both."""
    scene = np.concatenate([*screens, cloud])
    low, high = scene.min(axis=0), scene.max(axis=0)
    reach = max(high[2] - low[2], high[1] - low[1])
    near = camera is not None and camera[2] - high[2] < FAR_CAMERA * reach
    if camera is not None and near:
        low, high = np.minimum(low, camera), np.maximum(high, camera)
    room = 0.06 * max(high[2] - low[2], high[1] - low[1]) + 1e-9
    across_mm, up_mm = high[2] - low[2] + 4 * room, high[1] - low[1] + 2 * room
    scale = min((DRAWING_WIDTH - 20) / across_mm, 300 / up_mm)
    height = round(scale * up_mm) + AXIS_HEIGHT
    left = (DRAWING_WIDTH - scale * across_mm) / 2
    x = Scale(low[2] - 2 * room, high[2] + 2 * room, left, DRAWING_WIDTH - left)
    y = Scale(low[1] - room, high[1] + room, height - AXIS_HEIGHT, 0)
    return {
        "size": (DRAWING_WIDTH, height),
        "screens": [line_path(x, y, [(c[2], c[1]) for c in (*corners, corners[0])]) for corners in screens],
        "labels": [
            (x.place(float(c[:, 2].mean())), y.place(float(c[:, 1].max())) - 6, n) for n, c in enumerate(screens)
        ],
        "dots": "".join(f"M{x.place(float(p[2])):g} {y.place(float(p[1])):g}h.01" for p in cloud),
        "camera": (x.place(float(camera[2])), y.place(float(camera[1]))) if camera is not None and near else None,
        "far": f"camera {number(float(camera[2]))} {unit.label} from the display"
        if camera is not None and not near
        else "",
        "ticks": x.ticks(6),
        "unit": unit.label,
    }


def calibration_panel(calibration: Calibration | None) -> Panel:
    """Return how well the calibration is known that the poses come from, and where its own page is."""
    data: dict[str, object] = {}
    if calibration is not None:
        quality = calibration.quality
        rows = [
            ("Made", calibration.created[:16].replace("T", ", ")),
            ("Holds until", holds_until(calibration)),
            ("Adds to the shape of the object", _length_mm(quality.fep_shape_error_mm)),
            ("Adds to its place, seen from the display", _length_mm(quality.fep_display_error_mm)),
            (
                "Adds to normals",
                NOTHING if quality.normal_error_deg is None else f"{number(quality.normal_error_deg, 2)}°",
            ),
            ("Poses measured for", ", ".join(calibration.poses)),
        ]
        rows += [(f"Position {slip.position}, dry to wet", slip.sentence()) for slip in slips_of(calibration)]
        data = {"address": CALIBRATION_PAGE_NAME, "table": Table(("Calibration", "Value"), tuple(rows))}
    return Panel(
        "calibration",
        "The calibration",
        "calibration.html.j2",
        data,
        "Poses, lens, pitch and cover glass of this result were measured, not taken from the configuration.",
        "An error of the shape far below what is to be measured, and a display that did not slip.",
        "A calibration older than it holds, or one from before the rig was moved: the warnings above name it.",
        missing="" if calibration else "No calibration was used: the poses are those that the manifest states.",
    )


def _length_mm(value: float | None) -> str:
    return NOTHING if value is None else f"{number(value, 2)} mm rms"


def setup_section(
    manifest: Manifest, maps: Maps, metrics: Metrics, *, unit: LengthUnit, calibration: Calibration | None = None
) -> Section:
    """Return the section on what was calibrated."""
    return Section(
        "setup",
        "Calibration and set-up",
        (
            drawing_panel(manifest, maps, unit),
            calibration_panel(calibration),
            poses_panel(manifest, unit),
            board_panel(metrics, unit),
            parts_panel(manifest, unit),
            patterns_panel(manifest),
        ),
    )
