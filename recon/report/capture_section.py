"""What the photos are worth: intensity curves of a few pixels with their fit, and a strip of quality a photo."""

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from recon.metrics import Metrics, PhotoQuality, SampleCurve, SceneComparison
from recon.report.charts import Scale, area_path, line_path, round_up
from recon.report.numbers import NOTHING, LengthUnit, Real, number
from recon.report.panel import Panel, Section, Table

CURVES_SHOWN = 24
# Samples on either side of the peak in the close view: a stripe is a few steps wide.
CLOSE_STEPS = 10
WIDTH, CLOSE_HEIGHT, WHOLE_HEIGHT = 320, 150, 34
LEFT, RIGHT, BOTTOM = 44, 8, 24
STRIP_WIDTH, STRIP_HEIGHT, STRIP_GAP, SHARE_HEIGHT = 460, 64, 14, 26


def curve_chart(curve: SampleCurve) -> dict[str, object]:
    """Return the drawing of one pixel's curve: whole sweep above, the neighbourhood of the peak below."""
    place = np.asarray(curve.place_px, dtype=np.float64)
    step = float(np.median(np.diff(place))) if place.size > 1 else 1.0
    centre = curve.peak_px if np.isfinite(curve.peak_px) else float(place[int(np.nanargmax(curve.intensity))])
    low = max(float(place[0]), centre - CLOSE_STEPS * step)
    high = min(float(place[-1]), centre + CLOSE_STEPS * step)
    top = 1.06 * max(*curve.intensity, *curve.model, 1e-9)
    bottom = min(0.0, *curve.intensity)
    whole_x = Scale(float(place[0]), float(place[-1]), LEFT, WIDTH - RIGHT)
    whole_y = Scale(bottom, top, WHOLE_HEIGHT, 2)
    x = Scale(low, high, LEFT, WIDTH - RIGHT)
    y = Scale(bottom, top, CLOSE_HEIGHT - BOTTOM, 6)
    samples = list(zip(curve.place_px, curve.intensity, strict=True))
    near = [(a, b) for a, b in samples if low <= a <= high]
    fitted = [(a, b) for a, b in zip(curve.place_px, curve.model, strict=False) if low <= a <= high]
    sd = curve.sd_px or 0.0
    return {
        "row": curve.row,
        "col": curve.col,
        "set": curve.set,
        "axis": curve.axis,
        # A curve that was kept only about its peak has no more to show than the close view.
        "whole": line_path(whole_x, whole_y, samples) if len(near) < len(samples) else "",
        "window": (whole_x.place(low), whole_x.place(high)),
        "dots": [(x.place(a), y.place(b)) for a, b in near],
        "fit": line_path(x, y, fitted),
        "peak": x.place(curve.peak_px) if low <= curve.peak_px <= high else None,
        "band": (x.place(curve.peak_px - sd), x.place(curve.peak_px + sd))
        if sd and np.isfinite(curve.peak_px)
        else None,
        "peak_text": number(float(curve.peak_px), 5),
        "sd_text": number(float(sd)) if sd else "",
        "x_ticks": x.ticks(4),
        "y_ticks": y.ticks(3),
    }


def curves_panel(curves: Sequence[SampleCurve]) -> Panel:
    """Return small charts of the sample pixels."""
    usable = [curve for curve in curves if len(curve.place_px) >= 3 and len(curve.intensity) == len(curve.place_px)]
    left_out = len(usable) - CURVES_SHOWN
    return Panel(
        "curves",
        "What single pixels saw",
        "curves.html.j2",
        {
            "charts": [curve_chart(curve) for curve in usable[:CURVES_SHOWN]],
            "size": (WIDTH, CLOSE_HEIGHT, WHOLE_HEIGHT, LEFT, RIGHT, BOTTOM),
            "fitted": any(curve.model for curve in usable),
            "left_out": max(0, left_out),
        },
        "Intensity of one pixel over the places of the stripe about its peak, in device pixels of the display: samples as dots, "
        "the fit as a line, the place found as an upright line with its sd as a band. A strip above, if any, is the whole sweep.",
        "One clear peak on a flat ground; dots on the line; no dot at the top of the range.",
        "Two peaks (two light paths in one pixel), a flat top (clipping), or a ground as high as the peak (stray light).",
        missing="" if usable else "The run kept no sample curves.",
    )


def level(value: Real) -> str:
    """Write a brightness: whole counts stay whole."""
    return number(int(value)) if float(value).is_integer() else number(value)


def photo_strip(photos: Sequence[PhotoQuality], *, top: float, share_top: float) -> dict[str, object]:
    """Return the drawing of one sweep: the brightest value a photo, and below it the saturated share."""
    ordered = sorted(photos, key=lambda photo: photo.index)
    x = Scale(ordered[0].index, max(ordered[-1].index, ordered[0].index + 1), LEFT, STRIP_WIDTH - RIGHT)
    y = Scale(0, top, STRIP_HEIGHT, 6)
    share_y = Scale(0, share_top, STRIP_HEIGHT + STRIP_GAP + SHARE_HEIGHT, STRIP_HEIGHT + STRIP_GAP)
    shares = [100 * photo.saturated_share for photo in ordered]
    brightest = [photo.brightest for photo in ordered]
    return {
        "set": ordered[0].set,
        "sweep": ordered[0].sweep,
        "count": len(ordered),
        "line": line_path(x, y, [(photo.index, photo.brightest) for photo in ordered]),
        "share": area_path(x, share_y, [(photo.index, value) for photo, value in zip(ordered, shares, strict=True)]),
        "x_ticks": x.ticks(5),
        "y_ticks": y.ticks(2),
        "brightest_median": level(float(np.median(brightest))),
        "darkest": level(min(brightest)),
        "worst_share": number(float(max(shares))),
        "share_top": number(float(share_top), 1),
    }


def photos_panel(photos: Sequence[PhotoQuality]) -> Panel:
    """Return the strip of capture quality: a small chart a sweep, single photos in a table."""
    groups = [list(group) for _, group in groupby(photos, key=lambda photo: (photo.set, photo.sweep))]
    sweeps = [group for group in groups if len(group) > 1]
    singles = tuple(
        (
            photo.set,
            photo.sweep,
            level(photo.brightest),
            f"{number(100 * photo.saturated_share)} %",
        )
        for group in groups
        if len(group) == 1
        for photo in group
    )
    # One scale for all, so that a dim set is seen to be dim.
    top = 1.06 * max((photo.brightest for photo in photos), default=1.0)
    share_top = round_up(max(0.1, *(100 * photo.saturated_share for photo in photos))) if photos else 1.0
    return Panel(
        "photos",
        "Quality photo by photo",
        "photos.html.j2",
        {
            "strips": [photo_strip(group, top=top, share_top=share_top) for group in sweeps],
            "singles": Table(("Set", "Photo", "Brightest", "Saturated"), singles, (2, 3)),
            "size": (STRIP_WIDTH, STRIP_HEIGHT, STRIP_GAP, SHARE_HEIGHT, LEFT, RIGHT),
            "count": len(photos),
        },
        "Upper line: the brightest value in each photo of a sweep. Lower area: the share of saturated pixels, in per cent of the "
        "photo.",
        "Smooth lines of one height in air and in liquid, low only where the stripe is out of sight; almost nothing saturated.",
        "A notch (a photo of the frame before, or a blank one), a jump (exposure, or light in the room), or saturation.",
        missing="" if photos else "The run recorded no quality of single photos.",
    )


def scene_panel(comparisons: Sequence[SceneComparison], note: str, unit: LengthUnit) -> Panel:
    """Return what the reference photos say: one row a comparison."""
    rows = tuple(
        (
            comparison.set,
            str(comparison.index),
            "first of the session" if comparison.across_sets else "first of its set",
            *(_shift_text(comparison, name) for name in ("marks", "display", "object")),
            _light_text(comparison),
            number(comparison.error_mm, 2),
            "; ".join(comparison.findings) or "as it was",
        )
        for comparison in comparisons
    )
    headings = (
        "Set",
        "Photo",
        "Compared with the",
        "Marks, px",
        "Display, px",
        "Through the object, px",
        "Light, %",
        f"Entry points, {unit.label}",
        "What happened",
    )
    table = Table(headings, rows, (1, 3, 4, 5, 6, 7))
    what = (
        "Reference photos show the same frame each. For the parts of the picture: how far they moved since the photo compared "
        "with (± sd; behind the slash how differently their blocks moved), the change of light, and how far off entry points "
        "may be for what was found: lever × shift / sin of the angle between the paths, median of this object's points."
    )
    return Panel(
        "scene",
        "Did the scene stay as it was?",
        "tables.html.j2",
        {"tables": (table,)},
        f"{what} {note[:1].upper()}{note[1:]}{'.' if note else ''}",
        "“As it was” in every row, shifts of a few hundredths of a pixel at most.",
        "Anything named in the last column: camera, object or display moved, the liquid was not still, the light changed.",
        missing=""
        if rows
        else f"Whether camera, object, display and light stayed as they were {note or 'is not in the metrics'}.",
    )


def _shift_text(comparison: SceneComparison, name: str) -> str:
    part = next((part for part in comparison.parts if part.name == name), None)
    if part is None:
        return NOTHING
    spread = f" / {part.spread_px:.3f}" if part.spread_px > 0 else ""
    return f"{part.shift_px:.3f} ± {part.sd_px:.3f}{spread}"


def _light_text(comparison: SceneComparison) -> str:
    part = next((part for part in comparison.parts if part.name == "display"), None)
    return NOTHING if part is None else f"{100 * part.light:+.2f} ± {100 * part.light_sd:.2f}".replace("-", "−")


def capture_section(metrics: Metrics, *, unit: LengthUnit) -> Section:
    """Return the section about the photos."""
    panels = (
        scene_panel(metrics.scene, metrics.scene_note, unit),
        curves_panel(metrics.curves),
        photos_panel(metrics.photos),
    )
    return Section("capture", "Capture", panels)
