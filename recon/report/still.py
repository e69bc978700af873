"""A still picture of the points, for paper and for browsers without WebGL 2."""

import io

import matplotlib
import numpy as np
from jaxtyping import Float, Float64, Int64
from matplotlib.image import imsave

from recon.report.point_scene import Cloud

# Where the 3-D view looks from at first: from the display, a little to the side and from above.
AZIMUTH_DEG, ELEVATION_DEG = 205.0, 22.0
WIDTH_PX, HEIGHT_PX = 1200, 760
POINTS_DRAWN = 400_000
AMBIENT = 0.35


def eye_direction() -> Float64[np.ndarray, " 3"]:
    """Return the direction from the object to the eye, in the frame of the report."""
    azimuth, elevation = np.radians(AZIMUTH_DEG), np.radians(ELEVATION_DEG)
    return np.array(
        [np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)],
    )


def still_png(cloud: Cloud, *, depth_limits_mm: tuple[float, float]) -> bytes:
    """Draw the points from the first direction of the 3-D view, coloured by depth and shaded by their normals.

    Each point is a square just large enough to close the surface; the nearest wins.
    """
    eye = eye_direction()
    right = np.cross([0.0, 1.0, 0.0], eye)
    right /= np.linalg.norm(right)
    up = np.cross(eye, right)
    across, height, nearness = cloud.point_mm @ right, cloud.point_mm @ up, cloud.point_mm @ eye
    scale = 0.92 * min(WIDTH_PX / max(float(np.ptp(across)), 1e-9), HEIGHT_PX / max(float(np.ptp(height)), 1e-9))
    col = np.round(WIDTH_PX / 2 + scale * (across - (across.max() + across.min()) / 2)).astype(np.int64)
    row = np.round(HEIGHT_PX / 2 - scale * (height - (height.max() + height.min()) / 2)).astype(np.int64)
    # Twice the mean spacing, so that a random sample leaves few holes.
    covered = max(1.0, scale**2 * float(np.ptp(across)) * float(np.ptp(height)))
    reach = int(np.clip(np.ceil(np.sqrt(covered / len(col))), 1, 6))
    drawn = _nearest(row, col, nearness, reach)
    low, high = depth_limits_mm
    shade = AMBIENT + (1 - AMBIENT) * np.abs(np.nan_to_num(cloud.normal, nan=1.0) @ eye).clip(0, 1)
    colour = matplotlib.colormaps["viridis"]((cloud.point_mm[:, 2] - low) / (high - low))[:, :3] * shade[:, None]
    picture = np.zeros((HEIGHT_PX, WIDTH_PX, 4))
    known = drawn >= 0
    picture[known, :3], picture[known, 3] = colour[drawn[known]], 1.0
    buffer = io.BytesIO()
    imsave(buffer, picture, format="png")
    return buffer.getvalue()


def _nearest(
    row: Int64[np.ndarray, " points"],
    col: Int64[np.ndarray, " points"],
    nearness: Float[np.ndarray, " points"],
    reach: int,
) -> Int64[np.ndarray, "rows cols"]:
    """Return for each pixel of the picture the number of the nearest point whose square covers it, else -1."""
    offset = np.arange(reach) - reach // 2
    order = np.argsort(nearness)
    rows = (row[order, None, None] + offset[:, None]).clip(0, HEIGHT_PX - 1)
    cols = (col[order, None, None] + offset).clip(0, WIDTH_PX - 1)
    rank = np.full(HEIGHT_PX * WIDTH_PX, -1, dtype=np.int64)
    np.maximum.at(rank, (rows * WIDTH_PX + cols).ravel(), np.repeat(np.arange(len(order)), reach * reach))
    return np.where(rank >= 0, order[rank], -1).reshape(HEIGHT_PX, WIDTH_PX)
