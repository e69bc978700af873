"""A drawing on the camera grid as PNG pictures, once for a light page and once for a dark one."""

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text

from recon.report.map_window import Window

# Ink and ground of the two themes of style.css.
THEMES = {"light": ("#24292f", "#e8eaed"), "dark": ("#d5dae0", "#2b313a")}
FIGURE_WIDTH_IN, DOTS_PER_IN = 4.8, 190
# Room round the map for tick labels, axis labels and the colour bar.
LEFT_IN, RIGHT_IN, KEY_IN, BOTTOM_IN, TOP_IN, BAR_IN = 0.58, 0.12, 1.02, 0.45, 0.1, 0.16
SMALLEST_HEIGHT_IN, LARGEST_HEIGHT_IN = 1.2, 4.6
# A picture a twentieth larger than the smallest, in two thirds of the time.
PNG_OPTIONS = {"compress_level": 4}
Draw = Callable[[Axes, Axes], None]


@dataclass(frozen=True, slots=True)
class Picture:
    """One figure in both themes, with the words for those who cannot see it."""

    light_png: bytes
    dark_png: bytes
    alt: str
    width: int
    height: int


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


def both_themes(draw: Draw, window: Window, alt: str, *, with_key: bool) -> Picture:
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
