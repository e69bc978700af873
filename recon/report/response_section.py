"""The panels of a display's response: levels, latency, flicker, drift and colour, each with its chart and its numbers."""

from collections.abc import Sequence

import numpy as np

from recon.calibration.latency import new_share
from recon.calibration.response_record import ResponseRecord
from recon.report.charts import Scale, line_path
from recon.report.numbers import number, plus_minus
from recon.report.panel import Panel, Section, Table
from recon.sessions.photos import PLANE_OF_PRIMARY

WIDTH, HEIGHT, LEFT, RIGHT, BOTTOM = 460, 230, 48, 10, 40
SMOOTH = 200
Points = Sequence[tuple[float, float]]


def chart(
    title: str,
    *,
    dots: Points,
    line: Points,
    x_title: str,
    table: Table,
    note: str = "",
    sd: Sequence[float] = (),
    mark: float | None = None,
    late: float | None = None,
    from_zero: bool = True,
) -> dict[str, object]:
    """Return the drawing of measured dots over a fitted line; ``mark`` and ``late`` are upright lines."""
    across = [x for x, _ in (*dots, *line)]
    up = [y for _, y in (*dots, *line)]
    lowest, highest = min(up), max(up)
    margin = 0.06 * (highest - lowest or 1.0)
    x = Scale(min(across), max(across), LEFT, WIDTH - RIGHT)
    y = Scale(0.0 if from_zero and lowest >= 0 else lowest - margin, highest + margin, HEIGHT - BOTTOM, 6)
    return {
        "title": title,
        "note": note,
        "size": (WIDTH, HEIGHT, LEFT, RIGHT, BOTTOM),
        "dots": [(x.place(a), y.place(b)) for a, b in dots],
        "bars": [
            (x.place(a), y.place(max(b - each, y.low)), y.place(b + each))
            for (a, b), each in zip(dots, sd, strict=False)
        ],
        "line": line_path(x, y, line),
        "mark": None if mark is None else x.place(mark),
        "late": None if late is None else x.place(late),
        "x_ticks": x.ticks(6),
        "y_ticks": y.ticks(4),
        "x_title": x_title,
        "table": table,
    }


def levels_panel(response: ResponseRecord) -> Panel:
    """Return photo values over drive levels."""
    data: dict[str, object] = {}
    found = response.levels
    if found is not None:
        smooth = np.linspace(0, 255, SMOOTH)
        curve = found.black + (found.white - found.black) * (smooth / 255) ** found.gamma
        rows = (
            ("Gamma", plus_minus(found.gamma, found.gamma_sd)),
            ("Black", f"{plus_minus(found.black, found.black_sd)} of {number(found.full_scale)}"),
            ("White", f"{plus_minus(found.white, found.white_sd)} of {number(found.full_scale)}"),
            ("From a curve that never falls", f"{number(found.residual_rms, 2)} counts rms"),
            ("From the gamma curve", f"{number(found.model_rms, 2)} counts rms"),
            ("Clips from level", "none" if found.clipped_from is None else number(found.clipped_from)),
        )
        data = chart(
            "Photo value over drive level",
            dots=list(zip(found.level, found.value, strict=True)),
            line=list(zip(smooth, np.minimum(curve, found.full_scale), strict=True)),
            x_title="drive level, 0 to 255",
            table=Table(("Levels", "Value ± sd"), rows),
            late=found.clipped_from,
        )
    return Panel(
        "levels",
        "Levels to photo values",
        "points.html.j2",
        data,
        "Mean count of the part of the photo that sees the display, for each drive level (dots), and the gamma curve through "
        "them. Display and camera bend the curve together. A table of all 256 levels is in response.json.",
        "Dots on the line, black near 0, white between half and nine tenths of the range.",
        "A flat top (clipping, dashed line), a dot below its left neighbour (dynamic contrast, automatic exposure), a raised "
        "black (light in the room).",
        missing=response.left_out.get("levels", ""),
    )


def latency_panel(response: ResponseRecord) -> Panel:
    """Return how much of the new frame photos show, over the time since the command."""
    data: dict[str, object] = {}
    found = response.latency
    if found is not None:
        smooth = np.linspace(min(found.after_s), max(found.after_s), SMOOTH)
        model = new_share(
            smooth, latency_s=found.latency_s, rise_s=found.rise_s, exposure_s=found.exposure_s, spread_s=found.spread_s
        )
        rows = (
            ("Command to half of the light", f"{plus_minus(1000 * found.latency_s, 1000 * found.latency_sd_s)} ms"),
            ("The change takes", f"{plus_minus(1000 * found.rise_s, 1000 * found.rise_sd_s)} ms"),
            ("The display says it is done after", f"{number(1000 * found.acknowledged_s)} ms"),
            ("A shutter may open after", f"{number(1000 * found.settled_s)} ms"),
            (
                "From first to last row the shutter takes",
                f"{plus_minus(1000 * found.readout_s, 1000 * found.readout_sd_s)} ms",
            ),
            ("Exposure of these photos", f"{number(1000 * found.exposure_s)} ms"),
            ("Photos from the line", f"{number(100 * found.share_rms, 2)} % rms"),
        )
        data = chart(
            "Share of the new frame over the time from the command",
            dots=[(1000 * a, b) for a, b in zip(found.after_s, found.share, strict=True)],
            line=[(1000 * a, b) for a, b in zip(smooth, model, strict=True)],
            x_title="ms from the command until the shutter opened",
            table=Table(("Latency", "Value ± sd"), rows),
            mark=1000 * found.settled_s if found.settled_s <= max(found.after_s) else None,
        )
    return Panel(
        "latency",
        "From the command to the light",
        "points.html.j2",
        data,
        "Black and white in turn. A photo whose shutter opens early holds a part of the frame before. The upright line is the "
        "first moment at which a photo holds the new frame alone. The camera's own delay is taken for negative latency.",
        "Dots on the line; the settle time of the configuration reaches beyond the upright line.",
        "Dots far from the line (the delay changes from frame to frame), or a line that has not reached 1 at its end.",
        missing=response.left_out.get("latency", ""),
    )


def flicker_panel(response: ResponseRecord) -> Panel:
    """Return the swing of the brightness over the shutter time."""
    data: dict[str, object] = {}
    found = response.flicker
    if found is not None:
        exposure_ms = [1000 * each for each in found.exposure_s]
        smooth = np.linspace(min(exposure_ms), max(exposure_ms), 4 * SMOOTH)
        line: list[tuple[float, float]] = []
        rows: tuple[tuple[str, str], ...] = (("Flicker", "none found"),)
        if found.frequency_hz is not None and found.frequency_sd_hz is not None:
            swing = 100 * found.depth * np.abs(np.sinc(found.frequency_hz * smooth / 1000))
            line = list(zip(smooth, swing, strict=True))
            rows = (
                ("Frequency", f"{plus_minus(found.frequency_hz, found.frequency_sd_hz)} Hz"),
                ("Depth", f"{plus_minus(100 * found.depth, 100 * found.depth_sd)} %"),
                ("Period", f"{number(1000 / found.frequency_hz)} ms"),
                ("Bands in a photo", "none seen" if found.bands_per_photo is None else number(found.bands_per_photo)),
                ("Safe shutter times", ", ".join(f"{each} s" for each in found.safe_times) or "none of the usual ones"),
            )
        data = chart(
            "Swing of the brightness over the shutter time",
            dots=[(a, 100 * b) for a, b in zip(exposure_ms, found.swing, strict=True)],
            line=line,
            sd=[100 * each for each in found.swing_sd],
            x_title="shutter time in ms",
            note="in per cent of the light, with standard deviations",
            table=Table(("Flicker", "Value ± sd"), rows),
        )
    return Panel(
        "flicker",
        "Flicker against shutter time",
        "points.html.j2",
        data,
        "How far the brightness of a steady white frame swings, within photos and from photo to photo, at each shutter time; the "
        "line is that of a sine. It touches zero where the shutter is open for whole periods.",
        "Dots near zero everywhere, or at least at the shutter time of the capture.",
        "A swing of more than half a per cent at the shutter time of the capture: stripes get brighter and darker by themselves.",
        missing=response.left_out.get("flicker", ""),
    )


def drift_panel(response: ResponseRecord) -> Panel:
    """Return the brightness of one frame over minutes."""
    data: dict[str, object] = {}
    found = response.drift
    if found is not None:
        minutes = [each / 60 for each in found.time_s]
        middle = float(np.mean(minutes))
        rows = (
            ("Change a minute", f"{plus_minus(100 * found.per_min, 100 * found.per_min_sd)} %"),
            ("Watched for", f"{number(max(minutes) - min(minutes))} min"),
        )
        data = chart(
            "Brightness of a white frame over time",
            dots=[(a - minutes[0], 100 * b) for a, b in zip(minutes, found.relative, strict=True)],
            line=[(a - minutes[0], 100 * found.per_min * (a - middle)) for a in (minutes[0], minutes[-1])],
            x_title="minutes",
            note="per cent from the mean",
            table=Table(("Drift", "Value ± sd"), rows),
            from_zero=False,
        )
    return Panel(
        "drift",
        "Brightness over minutes",
        "points.html.j2",
        data,
        "The same white frame, photographed now and then; the line is the straight line through it.",
        "Dots about zero; a slope that no sweep notices.",
        "A slope (the display warms up, or dims by itself) or jumps (automatic brightness, light in the room).",
        missing=response.left_out.get("drift", ""),
    )


def planes_panel(response: ResponseRecord) -> Panel:
    """Return how the light is spread over the colour planes."""
    found = response.planes
    rows: tuple[tuple[str, ...], ...] = ()
    if found is not None:
        rows = tuple(
            (name, f"{number(100 * found.share[plane])} ± {number(100 * found.sd[plane], 2)} %")
            for name, plane in sorted(PLANE_OF_PRIMARY.items(), key=lambda each: each[1])
        )
    caption = f"Light in each plane of the photo, display set to {response.display.primary}"
    caption += "; the photos are grey, so all planes are one" if found is not None and found.grey else ""
    return Panel(
        "planes",
        "One primary alone",
        "table.html.j2",
        {"table": Table(("Plane", "Share of the strongest"), rows, (1,), caption)},
        "One colour keeps the glass's dispersion out of a stripe's edges.",
        "The configured primary at 100 %, the others at a few per cent.",
        "Another plane with a quarter or more: white balance, picture style, or a display that shows more than one colour.",
        missing=response.left_out.get("planes", ""),
    )


def response_section(response: ResponseRecord) -> Section:
    """Return the section about the display's behaviour."""
    return Section(
        "response",
        "Display response",
        (
            levels_panel(response),
            latency_panel(response),
            flicker_panel(response),
            drift_panel(response),
            planes_panel(response),
        ),
    )
