"""What a calibration rests on, photo by photo and part by part of the picture, as the file keeps it for people to look at."""

from typing import Annotated

import numpy as np
from pydantic import Field

from recon.calibration.bundle import BundleResult
from recon.calibration.coverage import CELLS_ACROSS, CELLS_DOWN
from recon.calibration.intrinsics import OUTLIER_RATIO, LensEstimate
from recon.sessions.manifest import Finite, Part


class SeenView(Part):
    """One photo of the board: its corners, how many of them were left out as wrong, and the rms of those that were kept.

    ``pose`` is the set whose pose it told, empty for one of the lens; ``disagrees`` marks a view that does not fit the others.
    """

    name: str
    corners: Annotated[int, Field(ge=0)]
    corners_dropped: Annotated[int, Field(ge=0)] = 0
    rms_px: Annotated[float, Field(ge=0)]
    pose: str = ""
    disagrees: bool = False


class PictureCell(Part):
    """A part of the photo: corners that the lens's views have in it, and their mean residual (measured less predicted)."""

    corners: Annotated[int, Field(ge=0)]
    residual_x_px: Finite = 0.0
    residual_y_px: Finite = 0.0


class Evidence(Part):
    """Views of the lens and of the display, and the photo in equal cells, ``cells[down][across]``."""

    lens_views: tuple[SeenView, ...] = ()
    display_views: tuple[SeenView, ...] = ()
    cells: tuple[tuple[PictureCell, ...], ...] = ()


def evidence_of(lens: LensEstimate, poses: BundleResult, *, columns: int, rows: int) -> Evidence:
    """Return what a lens and an adjustment of the display's poses rest on; photos have ``columns`` by ``rows`` pixels."""
    lens_views = tuple(
        SeenView(name=view.name, corners=len(residual), rms_px=rms, disagrees=view.name in lens.outliers)
        for view, residual, rms in zip(lens.views, lens.residual_px, lens.view_rms_px, strict=True)
    )
    display_views = []
    limit_px = OUTLIER_RATIO * poses.rms_px
    for sighting, residual, kept in zip(poses.sightings, poses.residual_px, poses.kept, strict=True):
        rms_px = float(np.sqrt((residual[kept] ** 2).sum(axis=1).mean())) if kept.any() else 0.0
        display_views.append(
            SeenView(
                name=sighting.view.name,
                corners=len(residual),
                corners_dropped=int(np.count_nonzero(~kept)),
                rms_px=rms_px,
                pose=sighting.panel,
                disagrees=rms_px > limit_px,
            )
        )
    return Evidence(
        lens_views=lens_views,
        display_views=tuple(display_views),
        cells=picture_cells(lens, columns=columns, rows=rows),
    )


def picture_cells(lens: LensEstimate, *, columns: int, rows: int) -> tuple[tuple[PictureCell, ...], ...]:
    """Return number and mean residual of the lens's corners in each cell of the photo."""
    place_px = np.concatenate([view.place_px for view in lens.views])
    residual_px = np.concatenate(lens.residual_px)
    across = np.clip(((place_px[:, 0] + 0.5) * CELLS_ACROSS / columns).astype(int), 0, CELLS_ACROSS - 1)
    down = np.clip(((place_px[:, 1] + 0.5) * CELLS_DOWN / rows).astype(int), 0, CELLS_DOWN - 1)
    found = []
    for row in range(CELLS_DOWN):
        cells = []
        for column in range(CELLS_ACROSS):
            inside = residual_px[(down == row) & (across == column)]
            x_px, y_px = inside.mean(axis=0) if len(inside) else (0.0, 0.0)
            cells.append(PictureCell(corners=len(inside), residual_x_px=float(x_px), residual_y_px=float(y_px)))
        found.append(tuple(cells))
    return tuple(found)
