"""Maps on the camera grid as PNG pictures with a colour bar, once for a light page and once for a dark one."""

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from jaxtyping import Bool, Float, Float64, UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from recon.report.numbers import number
from recon.status import PixelStatus

# Ink and ground of the two themes of style.css.
THEMES = {"light": ("#24292f", "#e8eaed"), "dark": ("#d5dae0", "#2b313a")}
FIGURE_WIDTH_IN, DOTS_PER_IN = 4.8, 190
# Room round the map for tick labels, axis labels and the colour bar.
LEFT_IN, RIGHT_IN, KEY_IN, BOTTOM_IN, TOP_IN, BAR_IN = 0.58, 0.12, 1.02, 0.45, 0.1, 0.16
SMALLEST_HEIGHT_IN, LARGEST_HEIGHT_IN = 1.2, 4.6
# A limit set by one outlier in a hundred says nothing about the surface.
LIMIT_PERCENTILES = (1.0, 99.0)
LARGEST_RATIO = 100.0
# A picture a twentieth larger than the smallest, in two thirds of the time.
PNG_OPTIONS = {"compress_level": 4}
Draw = Callable[[Axes, Axes], None]

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


@dataclass(frozen=True, slots=True)
class Picture:
    """One figure in both themes, with the words for those who cannot see it."""

    light_png: bytes
    dark_png: bytes
    alt: str
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of the camera grid and the step at which it is shown."""

    row_start: int
    row_stop: int
    col_start: int
    col_stop: int
    step: int

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Edges in camera pixels for ``imshow``: left, right, bottom, top."""
        return (self.col_start - 0.5, self.col_stop - 0.5, self.row_stop - 0.5, self.row_start - 0.5)

    def part(self, grid: np.ndarray) -> np.ndarray:
        """Return the part of a map, with every pixel of it."""
        return grid[self.row_start : self.row_stop, self.col_start : self.col_stop]

    def cut(self, grid: np.ndarray) -> np.ndarray:
        """Return the part of a map, thinned to the step."""
        return self.part(grid)[:: self.step, :: self.step]


def window_around(wanted: Bool[np.ndarray, "rows cols"], *, longest_px: int) -> Window:
    """Return the rectangle that holds every wanted pixel with a little room, thinned to ``longest_px``."""
    rows, cols = (np.flatnonzero(wanted.any(axis=axis)) for axis in (1, 0))
    if rows.size == 0:
        bounds = (0, wanted.shape[0], 0, wanted.shape[1])
    else:
        room = 2 + max(np.ptp(rows), np.ptp(cols)) // 40
        bounds = (
            max(0, int(rows[0] - room)),
            min(wanted.shape[0], int(rows[-1] + room + 1)),
            max(0, int(cols[0] - room)),
            min(wanted.shape[1], int(cols[-1] + room + 1)),
        )
    longest = max(bounds[1] - bounds[0], bounds[3] - bounds[2])
    return Window(*bounds, step=max(1, -(-longest // longest_px)))


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

    return _both_themes(draw, window, alt, with_key=True)


def normal_picture(normal: Float64[np.ndarray, "shown_rows shown_cols 3"], window: Window, *, alt: str) -> Picture:
    """Draw normals as colours: x red, y green, -z blue, from -1 (none) to 1 (full), with a half ball as the key.

    ``normal`` is already cut to the window, in the frame of the report.
    """
    shown = normal_colours(normal)

    def draw(axes: Axes, key: Axes) -> None:
        axes.imshow(shown, extent=window.extent, interpolation="nearest")
        ball_key(key)

    return _both_themes(draw, window, alt, with_key=True)


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

    return _both_themes(draw, window, alt, with_key=False)


@dataclass(frozen=True, slots=True)
class Layout:
    """Where map and key stand in the figure, as parts of its width and height."""

    height_in: float
    map_box: tuple[float, float, float, float]
    key_box: tuple[float, float, float, float]


def layout_of(window: Window, *, with_key: bool) -> Layout:
    """Return a layout in which the map keeps its proportions and leaves room for ticks, labels and a colour bar.

    Computed here rather than by matplotlib's layout engine, which draws every text several times.
    """
    rows, cols = window.row_stop - window.row_start, window.col_stop - window.col_start
    room_in = FIGURE_WIDTH_IN - LEFT_IN - (KEY_IN if with_key else RIGHT_IN)
    width_in = min(room_in, LARGEST_HEIGHT_IN * cols / rows)
    tall_in = max(width_in * rows / cols, SMALLEST_HEIGHT_IN)
    height_in = tall_in + BOTTOM_IN + TOP_IN
    left, bottom = LEFT_IN / FIGURE_WIDTH_IN, BOTTOM_IN / height_in
    across, up = width_in / FIGURE_WIDTH_IN, tall_in / height_in
    key_width = BAR_IN / FIGURE_WIDTH_IN
    return Layout(height_in, (left, bottom, across, up), (left + across + 0.6 * key_width, bottom, key_width, up))


def _both_themes(draw: Draw, window: Window, alt: str, *, with_key: bool) -> Picture:
    """Render one drawing with the inks of the light and then of the dark page."""
    layout = layout_of(window, with_key=with_key)
    pictures: dict[str, bytes] = {}
    figure = Figure(figsize=(FIGURE_WIDTH_IN, layout.height_in), dpi=DOTS_PER_IN)
    FigureCanvasAgg(figure)
    for theme, (ink, ground) in THEMES.items():
        inks: Any = {
            "text.color": ink,
            "axes.labelcolor": ink,
            "axes.edgecolor": ink,
            "xtick.color": ink,
            "ytick.color": ink,
            "axes.facecolor": ground,
            "font.size": 9,
            "axes.linewidth": 0.5,
            "xtick.major.width": 0.5,
            "ytick.major.width": 0.5,
        }
        with matplotlib.rc_context(inks):
            if not figure.axes:
                axes = figure.add_axes(layout.map_box)
                draw(axes, figure.add_axes(layout.key_box) if with_key else axes)
                axes.set_xlabel("camera column (px)")
                axes.set_ylabel("camera row (px)")
                axes.locator_params(nbins=5)
                for side in ("top", "right"):
                    axes.spines[side].set_visible(False)
            else:
                recolour(figure, dict(zip(THEMES["light"], (ink, ground), strict=True)))
            buffer = io.BytesIO()
            figure.savefig(buffer, format="png", facecolor="none", metadata={"Software": None}, pil_kwargs=PNG_OPTIONS)
            pictures[theme] = buffer.getvalue()
    size = round(FIGURE_WIDTH_IN * DOTS_PER_IN), round(layout.height_in * DOTS_PER_IN)
    return Picture(pictures["light"], pictures["dark"], alt, *size)


def recolour(figure: Figure, colours: Mapping[str, str]) -> None:
    """Give texts, lines and frames of a figure the colours that stand for those they have."""
    new = {to_rgba(old): colour for old, colour in colours.items()}
    for artist in figure.findobj(lambda one: isinstance(one, Text | Line2D | Patch)):
        for name in ("color", "markeredgecolor", "edgecolor", "facecolor"):
            if hasattr(artist, f"get_{name}"):
                colour = new.get(to_rgba(getattr(artist, f"get_{name}")()))
                if colour is not None:
                    artist.set(**{name: colour})
