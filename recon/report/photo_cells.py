"""The drawing of a photo in equal cells, each with a shade and a number, or with an arrow."""

import numpy as np
from jaxtyping import Float64

from recon.calibration.calibration_file import CalibratedCamera
from recon.calibration.coverage import CELLS_ACROSS, CELLS_DOWN
from recon.report.charts import round_up
from recon.report.numbers import number

WIDTH = 460
# An arrow is at most this share of a cell's shorter side long.
ARROW_SHARE = 0.85


def cell_centres(camera: CalibratedCamera) -> Float64[np.ndarray, "cells 2"]:
    """Return the middle of each cell of the photo, row by row, px."""
    across = (np.arange(CELLS_ACROSS) + 0.5) * camera.columns / CELLS_ACROSS - 0.5
    down = (np.arange(CELLS_DOWN) + 0.5) * camera.rows / CELLS_DOWN - 0.5
    return np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)


def empty_grid(camera: CalibratedCamera) -> dict[str, object]:
    """Return the drawing of a photo in cells, with nothing in them."""
    height = round(WIDTH * camera.rows / camera.columns)
    return {"size": (WIDTH, height), "label": "", "squares": [], "arrows": "", "scale": "", "enlarged": ""}


def squares(camera: CalibratedCamera) -> list[tuple[float, float, float, float]]:
    """Return x, y, width and height of each cell in the drawing, row by row."""
    height = round(WIDTH * camera.rows / camera.columns)
    wide, high = WIDTH / CELLS_ACROSS, height / CELLS_DOWN
    return [
        (round(column * wide, 2), round(row * high, 2), round(wide, 2), round(high, 2))
        for row in range(CELLS_DOWN)
        for column in range(CELLS_ACROSS)
    ]


def add_square(
    drawing: dict[str, object],
    square: tuple[float, float, float, float],
    share: float,
    text: str,
    *,
    empty: bool = False,
) -> None:
    """Add a cell that is as dark as ``share`` says (0 to 1); an empty one is hatched."""
    cells = drawing["squares"]
    assert isinstance(cells, list)
    cells.append((*square, round(0.08 + 0.5 * share, 3) if share else 0.0, text, empty))


def add_arrows(
    drawing: dict[str, object],
    camera: CalibratedCamera,
    shift_px: Float64[np.ndarray, "cells 2"],
    *,
    whole_px: float = 0.0,
) -> None:
    """Add an arrow about the middle of each cell, enlarged so that the longest, or ``whole_px``, just fits; say by how much."""
    longest_px = float(np.linalg.norm(shift_px, axis=1).max())
    if longest_px == 0:
        return
    shorter = min(camera.columns / CELLS_ACROSS, camera.rows / CELLS_DOWN)
    enlarged = ARROW_SHARE * shorter / max(longest_px, whole_px)
    # Round numbers, so that the reader can divide.
    enlarged = round_up(enlarged) if round_up(enlarged) <= enlarged * 1.001 else round_up(enlarged / 2.5)
    to_drawing = WIDTH / camera.columns
    words = []
    for (x, y), (dx, dy) in zip(cell_centres(camera) + 0.5, shift_px * enlarged, strict=True):
        words.append(arrow(to_drawing * (x - dx / 2), to_drawing * (y - dy / 2), to_drawing * dx, to_drawing * dy))
    drawing["arrows"] = "".join(words)
    drawing["enlarged"] = f"Arrows enlarged {enlarged:,.0f} times; the longest stands for {number(longest_px, 2)} px."


def arrow(x: float, y: float, across: float, down: float) -> str:
    """Return the path of an arrow."""
    length = float(np.hypot(across, down))
    if length < 0.3:
        return f"M{x:.1f} {y:.1f}h.01"
    head = min(4.0, 0.45 * length) / length
    tip_x, tip_y = x + across, y + down
    sides = [
        (tip_x - head * (across * 0.87 - sign * down * 0.5), tip_y - head * (down * 0.87 + sign * across * 0.5))
        for sign in (1, -1)
    ]
    ends = "".join(f"M{end_x:.1f} {end_y:.1f}L{tip_x:.1f} {tip_y:.1f}" for end_x, end_y in sides)
    return f"M{x:.1f} {y:.1f}L{tip_x:.1f} {tip_y:.1f}{ends}"
