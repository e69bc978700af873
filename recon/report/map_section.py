"""The maps on the camera grid: depth, normal, angle between the paths, gap, sd and status."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, UInt8

from recon.maps import Maps
from recon.report.charts import Scale, area_path
from recon.report.display_frame import depths, frame_from_world, rotate
from recon.report.map_pictures import STATUS_COLOURS, class_picture, normal_picture, scalar_picture
from recon.report.map_window import window_around
from recon.report.numbers import LengthUnit, number, share
from recon.report.panel import Panel, Section
from recon.report.paths_panel import paths_panel
from recon.report.theme_pictures import Picture
from recon.sessions.manifest import Manifest
from recon.status import REASONS, PixelStatus

HISTOGRAM_SIZE, HISTOGRAM_BINS = (440, 104), 60
HISTOGRAM_REACH = 10.0


@dataclass(frozen=True, slots=True)
class ScalarMap:
    """How one map of a number a pixel is shown and what its reader should look for."""

    id: str
    title: str
    what: str
    good: str
    bad: str
    label: str
    colours: str
    none: str
    symmetric: bool = False
    logarithmic: bool = False


def scalar_maps(unit: LengthUnit, *, with_gap_sign: bool, thin: bool) -> tuple[ScalarMap, ...]:
    """Return the settings of the scalar maps, in the unit of the session and the words of its method."""
    length = unit.label
    bends = (
        "the object bends each path away from its visual ray"
        if thin
        else "the liquid bends each path away from its course in air"
    )
    both = "the path through the object and the visual ray" if thin else "the path in air and the path in liquid"
    return (
        ScalarMap(
            "depth",
            "Depth",
            "Distance of each point from the plane of the display at position 0, towards the camera.",
            "Smooth shading that follows the object, with clean edges.",
            "Speckle, stair steps, or a slope that the object does not have (a display pose that is wrong).",
            f"depth ({length})",
            "viridis",
            "No pixel has a point.",
        ),
        ScalarMap(
            "angle",
            "Angle between the two light paths",
            f"How far {bends}; point and normal rest on this angle.",
            "Several degrees over most of the object.",
            "Large areas near zero: there the paths are almost parallel and the point is uncertain along them.",
            "angle (°)",
            "cividis",
            "No pixel has two paths.",
        ),
        ScalarMap(
            "gap",
            "Gap between the two light paths",
            f"The distance by which {both} miss each other; they should meet."
            + (" Its sign tells on which side." if with_gap_sign else ""),
            "Fine noise about zero without any pattern.",
            "A slope, rings or one colour all over: the display or the object moved between sets, or a pose is wrong.",
            f"gap ({length})",
            "RdBu_r" if with_gap_sign else "magma",
            "No pixel has two paths.",
            symmetric=with_gap_sign,
        ),
        ScalarMap(
            "sd",
            "Standard deviation of each point",
            "The uncertainty of each point as propagated from its correspondences (root of the covariance's trace); "
            "the colours end at a hundred times the median.",
            "Dark over most of the object, growing only where the angle between the paths is small.",
            "Bright areas: points there should be left out or weighted down.",
            f"sd ({length}, logarithmic)",
            "magma",
            "The reconstruction gave no standard deviations; the method `paper` estimates none.",
            logarithmic=True,
        ),
    )


def map_section(maps: Maps, manifest: Manifest, *, unit: LengthUnit, longest_px: int) -> Section:
    """Return the section of maps; ``longest_px`` bounds the samples along a picture's longer side."""
    frame = frame_from_world(manifest)
    values: dict[str, Float[np.ndarray, "rows cols"]] = {
        "depth": depths(frame, maps.point_mm),
        "angle": np.degrees(maps.pbc_angle_rad),
        "gap": maps.gap_mm,
        "sd": maps.sd_mm,
    }
    signed = bool((maps.gap_mm[np.isfinite(maps.gap_mm)] < 0).any())
    panels = [
        _scalar_panel(each, values[each.id], longest_px)
        for each in scalar_maps(unit, with_gap_sign=signed, thin=manifest.method == "thin")
    ]
    panels.insert(1, _normal_panel(frame, maps.normal, longest_px))
    panels.append(distributions_panel(values, unit))
    panels.append(_status_panel(maps.status, longest_px))
    if maps.path_count is not None:
        panels.append(paths_panel(maps.path_count, maps.valid(), longest_px=longest_px))
    return Section(
        "maps",
        "Maps",
        tuple(panels),
        "Each map has one value a camera pixel and is cut to the pixels that have one; axes are pixels of the photo. "
        "The colours span the 1st to the 99th percentile, so that a few outliers do not hide the rest.",
    )


def distributions_panel(values: Mapping[str, Float[np.ndarray, "rows cols"]], unit: LengthUnit) -> Panel:
    """Return histograms of angle, gap and sd."""
    named = (("angle", "angle", "°"), ("gap", "gap", unit.label), ("sd", "standard deviation", unit.label))
    shown = [
        histogram_chart(finite, name=title, unit=unit_text)
        for name, title, unit_text in named
        if (finite := values[name][np.isfinite(values[name])].astype(np.float64)).size
    ]
    return Panel(
        "distributions",
        "How the values spread",
        "histograms.html.j2",
        {"charts": shown, "size": HISTOGRAM_SIZE},
        "Pixels over value, from the 1st percentile to the 99th or ten medians; full line: median, dashed: 95th percentile.",
        "One hump each; the gap's is narrow and stands on zero.",
        "Two humps (two surfaces, or sets that do not belong together), or a gap that does not stand on zero.",
        missing="" if shown else "No pixel has a value.",
        wide=False,
    )


def histogram_chart(values: Float64[np.ndarray, " values"], *, name: str, unit: str) -> dict[str, object]:
    """Return the drawing of one histogram."""
    low, middle, late, high = (float(v) for v in np.percentile(values, (1, 50, 95, 99)))
    if low > 0:
        # A standard deviation, unlike an angle or a gap, may exceed all others by powers of ten.
        high = min(high, HISTOGRAM_REACH * middle)
    high = high if high > low else low + max(abs(low), 1e-6)
    counts, edges = np.histogram(values, bins=HISTOGRAM_BINS, range=(low, high))
    width, height = HISTOGRAM_SIZE
    x, y = Scale(low, high, 8, width - 8), Scale(0, float(counts.max() or 1), height - 20, 4)
    steps = [(edge, count) for k, count in enumerate(counts) for edge in (float(edges[k]), float(edges[k + 1]))]
    return {
        "name": f"{name} ({unit})",
        "area": area_path(x, y, [(edge, float(count)) for edge, count in steps]),
        "middle": x.place(middle),
        "late": x.place(late) if late <= high else None,
        "text": f"median {number(middle)}, 95th percentile {number(late)}",
        "ticks": x.ticks(5),
    }


def _scalar_panel(settings: ScalarMap, values: Float[np.ndarray, "rows cols"], longest_px: int) -> Panel:
    finite = np.isfinite(values)
    picture: Picture | None = None
    step = 1
    if finite.any():
        window = window_around(finite, longest_px=longest_px)
        step = window.step
        known = window.part(values)[window.part(finite)].astype(np.float64)
        low, middle, high = (number(float(v)) for v in np.percentile(known, (5, 50, 95)))
        picture = scalar_picture(
            values,
            window,
            label=settings.label,
            alt=f"Map of {settings.label}: median {middle}, 5 % below {low}, 5 % above {high}.",
            colours=settings.colours,
            symmetric=settings.symmetric,
            logarithmic=settings.logarithmic,
        )
    return Panel(
        settings.id,
        settings.title,
        "map.html.j2",
        {"picture": picture, "step": step},
        settings.what,
        settings.good,
        settings.bad,
        missing="" if picture else settings.none,
        wide=False,
    )


def _normal_panel(
    frame: Float64[np.ndarray, "4 4"], normal: Float64[np.ndarray, "rows cols 3"], longest_px: int
) -> Panel:
    # Three maps of the photo, one after the other: over a last axis of three, NumPy goes pixel by pixel.
    known = np.logical_and.reduce([np.isfinite(normal[..., axis]) for axis in range(3)])
    picture, step = None, 1
    if known.any():
        window = window_around(known, longest_px=longest_px)
        step = window.step
        shown = rotate(frame, window.cut(normal))
        tilt_deg = np.degrees(np.arccos(np.clip(-shown[..., 2], -1, 1)))
        picture = normal_picture(
            shown,
            window,
            alt="Map of normals as colours; their "
            f"median tilt from the display's axis is {number(float(np.nanmedian(tilt_deg)))}°.",
        )
    return Panel(
        "normal",
        "Normals",
        "map.html.j2",
        {"picture": picture, "step": step},
        "The direction of the surface. The ball is the key: lilac faces the display, other colours tilt away from it.",
        "Colours that change as smoothly as on the ball, with sharp changes only at the object's edges.",
        "Speckle, or blotches of one colour where the surface is known to curve.",
        missing="" if picture else "No pixel has a normal.",
        wide=False,
    )


def _status_panel(pixel_status: UInt8[np.ndarray, "rows cols"], longest_px: int) -> Panel:
    count_of = np.bincount(pixel_status.ravel(), minlength=len(PixelStatus)).tolist()
    rows = [
        (STATUS_COLOURS[status], status.name.lower().replace("_", " "), REASONS[status], count_of[status])
        for status in PixelStatus
    ]
    with_point = share(count_of[PixelStatus.OK], pixel_status.size)
    picture = class_picture(
        pixel_status,
        [STATUS_COLOURS[status] for status in PixelStatus],
        longest_px=longest_px,
        alt=f"Map of the reason why each pixel has a point or has none; {with_point} of the photo has a point.",
    )
    return Panel(
        "status",
        "Why a pixel has a point, or has none",
        "status.html.j2",
        {"picture": picture, "rows": rows, "total": int(pixel_status.size)},
        "The first test that a pixel fails names its colour. The whole photo is shown.",
        "One closed area with points, and unlit pixels only where the photo does not show the display.",
        "Holes inside the object: look up their colour in the key and see what it names.",
    )
