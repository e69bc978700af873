"""Maps on the camera grid as pictures with a colour bar: of one number a pixel, of normals, of classes."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float64, UInt8
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm, Normalize
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from recon.report.map_window import Window, window_around
from recon.report.numbers import number
from recon.report.theme_pictures import Picture, both_themes
from recon.status import PixelStatus

# A limit set by one outlier in a hundred says nothing about the surface.
LIMIT_PERCENTILES = (1.0, 99.0)
LARGEST_RATIO = 100.0

STATUS_COLOURS: dict[PixelStatus, str] = {
    PixelStatus.OK: "#2a9d8f",
    PixelStatus.UNLIT: "#5c6773",
    PixelStatus.PARTLY_LIT: "#e9c46a",
    PixelStatus.MASKED_OUT: "#b8bec6",
    PixelStatus.SWEEP_EDGE: "#f4843d",
    PixelStatus.BAD_FIT: "#d1345b",
    PixelStatus.PARALLEL_PATHS: "#8e5bd0",
    PixelStatus.GAP_TOO_LARGE: "#ef8fc4",
    PixelStatus.OUTSIDE_DEPTH: "#2667c9",
    PixelStatus.BESIDE_OBJECT: "#8ecae6",
    PixelStatus.BAD_CODE: "#7f4f24",
    PixelStatus.TWO_PATHS: "#00b4d8",
    PixelStatus.HALF_SEEN: "#606c38",
    PixelStatus.STANDS_ALONE: "#6d213c",
    PixelStatus.COVERED: "#95d5b2",
    PixelStatus.WET_SPOT: "#ffb703",
}


def limits(values: Float[np.ndarray, "*grid"], *, symmetric: bool = False) -> tuple[float, float]:
    """Return the colour limits: the 1st and 99th percentile, or a range about zero that holds 98 %."""
    finite = values[np.isfinite(values)].astype(np.float64)
    if symmetric:
        reach = float(np.percentile(np.abs(finite), 98)) or 1e-9
        return -reach, reach
    low, high = (float(value) for value in np.percentile(finite, LIMIT_PERCENTILES))
    if high - low <= 1e-9 * max(abs(low), abs(high), 1e-9):
        # A perfectly flat map still needs a scale.
        margin = 0.5 * max(abs(low), 1e-6)
        return low - margin, high + margin
    return low, high


def positive_limits(values: Float[np.ndarray, "*grid"]) -> tuple[float, float]:
    """Return the ends of a logarithmic scale: 1st to 99th percentile, but at most ``LARGEST_RATIO`` times the median.

    A standard deviation has no upper bound: where a point rests on nothing it exceeds the others by many powers of ten.
    """
    usable = values[np.isfinite(values) & (values > 0)].astype(np.float64)
    if not usable.size:
        return 0.5, 1.0
    low, middle, high = (float(value) for value in np.percentile(usable, (1, 50, 99)))
    high = min(high, LARGEST_RATIO * middle)
    return low, max(high, 1.001 * low)


def scalar_picture(
    values: Float[np.ndarray, "rows cols"],
    window: Window,
    *,
    label: str,
    alt: str,
    colours: str,
    symmetric: bool = False,
    logarithmic: bool = False,
) -> Picture:
    """Draw a map of one number a pixel, whose values are all within the window; pixels without one show the ground."""
    shown, known = window.cut(values), window.part(values)
    norm = LogNorm(*positive_limits(known)) if logarithmic else Normalize(*limits(known, symmetric=symmetric))

    def draw(axes: Axes, key: Axes) -> None:
        image = axes.imshow(shown, extent=window.extent, cmap=colours, norm=norm, interpolation="nearest")
        bar = key.figure.colorbar(image, cax=key, extend="both", extendfrac=0.03)
        bar.set_label(label)
        if logarithmic:
            bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: number(float(value), 1)))
            bar.ax.yaxis.set_minor_formatter(NullFormatter())
        bar.outline.set_visible(False)

    return both_themes(draw, window, alt, with_key=True)


def normal_picture(normal: Float64[np.ndarray, "shown_rows shown_cols 3"], window: Window, *, alt: str) -> Picture:
    """Draw normals as colours: x red, y green, -z blue, from -1 (none) to 1 (full), with a half ball as the key.

    ``normal`` is already cut to the window, in the frame of the report.
    """
    shown = normal_colours(normal)

    def draw(axes: Axes, key: Axes) -> None:
        axes.imshow(shown, extent=window.extent, interpolation="nearest")
        ball_key(key)

    return both_themes(draw, window, alt, with_key=True)


def ball_key(key: Axes) -> None:
    """Draw the half ball that explains the colours of normals in the place of a colour bar."""
    left, bottom, width, height = key.get_position().bounds
    key.set_position((left, bottom + 0.5 * height - 1.5 * width, 3.6 * width, 3.0 * width))
    x, y = np.meshgrid(np.linspace(-1, 1, 121), np.linspace(1, -1, 121))
    inside = x**2 + y**2 <= 1
    z = -np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    ball = np.where(inside[..., None], np.stack([x, y, z], axis=-1), np.nan)
    key.imshow(normal_colours(ball), extent=(-1, 1, -1, 1))
    key.set_axis_off()
    for place, word, vertical in (((0, 1.15), "up", "bottom"), ((0, -1.15), "left     right", "top")):
        key.text(*place, word, ha="center", va=vertical, fontsize=8)


def normal_colours(normal: Float64[np.ndarray, "*grid 3"]) -> UInt8[np.ndarray, "*grid 4"]:
    """Return the colour of each normal with alpha 0 where there is none.

    Normals are in the frame of the report, where they point towards the display (z < 0), so -z is the blue part.
    """
    known = np.isfinite(normal).all(axis=-1)
    parts = np.where(known[..., None], normal, 0.0) * np.array([1.0, 1.0, -1.0])
    colours = np.round(255 * (0.5 + 0.5 * np.clip(parts, -1, 1)))
    return np.concatenate([colours, 255.0 * known[..., None]], axis=-1).astype(np.uint8)


def class_picture(
    classes: UInt8[np.ndarray, "rows cols"], colours: Sequence[str], *, longest_px: int, alt: str
) -> Picture:
    """Draw the class 0, 1, … of each pixel of the whole photo; the key to the colours is a table beside it."""
    window = window_around(np.ones(classes.shape, dtype=bool), longest_px=longest_px)
    norm = BoundaryNorm(np.arange(len(colours) + 1) - 0.5, len(colours))

    def draw(axes: Axes, _: Axes) -> None:
        shown, key = window.cut(classes), ListedColormap(list(colours))
        axes.imshow(shown, extent=window.extent, cmap=key, norm=norm, interpolation="nearest")

    return both_themes(draw, window, alt, with_key=False)
