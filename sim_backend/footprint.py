"""How much of each device pixel a camera pixel sees, as sparse matrices.

Around each sub-ray the map from photo to display is nearly linear, so its square share of the photo covers a
parallelogram of the display. Seen along one display axis a parallelogram is a trapezoid, whose share of each (box
shaped) device column has a closed form: the stripe curves come out smooth, without the steps of point sampling.
The parallelogram stands about the middle of its light, which is not where the sub-ray ends if the map bends there.
"""

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from sim_backend.light_paths import ScreenMap

Grid = Float64[np.ndarray, "rows columns"]

# Near total reflection neighbouring rays part without limit and the linear map means nothing; a share of a pixel is
# never spread wider than this.
WIDEST_PX = 48.0

# Device images are sampled at this many places across a sub-ray's parallelogram, each way.
IMAGE_SAMPLES = 4

BAND_RAYS = 1 << 17
IMAGE_ROWS = 16


def local_slopes(place_px: Grid, route: Int64[np.ndarray, "rows columns"]) -> tuple[Grid, Grid]:
    """Return the change of a display coordinate from one sub-ray to the next, along columns and along rows.

    Only neighbours on the same route count: across an edge of the object there is no slope.
    """
    slopes = []
    for place, own in ((place_px, route), (place_px.T, route.T)):
        step, same = _steps(place, own)
        total, count = np.zeros_like(place), np.zeros(place.shape, np.int8)
        for part in (np.s_[:, :-1], np.s_[:, 1:]):
            total[part] += step
            count[part] += same
        slopes.append(np.clip(total / np.maximum(count, 1), -WIDEST_PX / 2, WIDEST_PX / 2))
    return slopes[0], slopes[1].T


def _steps(
    place_px: Grid, route: Int64[np.ndarray, "rows columns"]
) -> tuple[Float64[np.ndarray, "rows steps"], Bool[np.ndarray, "rows steps"]]:
    """Return the steps along columns, 0 across a change of route, and which are none of these."""
    step = np.diff(place_px, axis=1)
    same = (np.diff(route, axis=1) == 0) & np.isfinite(step)
    return np.where(same, step, 0.0), same


def middles_of_light(places: ScreenMap) -> ScreenMap:
    """Return where the light of each sub-ray's share of the photo lies on the mean, instead of where its middle looks.

    Over a square of side 1, whose middle looks at u, the mean of u + g·x + ½ x·C x in the light T (1 + a·x) is
    u + (C_xx + C_yy) / 24 + g·a / 12, for the mean of x² is 1/12. Where a sub-ray has no neighbours on its own route at
    both sides, nothing is known of bends.
    """
    fading = local_slopes(places.transmission.astype(np.float64), places.route)
    moved = []
    for place in (places.column_px, places.row_px):
        slopes = local_slopes(place, places.route)
        shift = _bend(place, places.route) / 24
        for slope, faded in zip(slopes, fading, strict=True):
            shift += slope * faded / (12 * np.maximum(places.transmission, 1e-6))
        within = 0.5 * (np.abs(slopes[0]) + np.abs(slopes[1]))  # the parallelogram, which no mean lies beyond
        moved.append(place + np.clip(shift, -within, within))
    return replace(places, column_px=moved[0], row_px=moved[1])


def _bend(place_px: Grid, route: Int64[np.ndarray, "rows columns"]) -> Grid:
    """Return the sum of the second differences along columns and along rows."""
    bend = np.zeros_like(place_px)
    for turned, place, own in ((bend, place_px, route), (bend.T, place_px.T, route.T)):
        step, same = _steps(place, own)
        turned[:, 1:-1] += np.where(same[:, 1:] & same[:, :-1], np.diff(step, axis=1), 0.0)
    return bend


def trapezoid_share(
    offset_px: Float64[np.ndarray, "*places"],
    wide_px: Float64[np.ndarray, "*places"],
    narrow_px: Float64[np.ndarray, "*places"],
) -> Float64[np.ndarray, "*places"]:
    """Return the share of a trapezoid that lies below ``offset_px`` from its centre.

    The trapezoid is the overlap of two boxes of widths ``wide_px`` ≥ ``narrow_px`` > 0 slid over each other.
    """
    half = 0.5 * (wide_px + narrow_px)
    distance = np.minimum(np.abs(offset_px), half)
    core = distance / wide_px
    flank = 0.5 - np.square(half - distance) / (2 * wide_px * narrow_px)
    return 0.5 + np.copysign(np.where(distance < 0.5 * (wide_px - narrow_px), core, flank), offset_px)


def _box_widths(slopes: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    first, second = np.abs(slopes[0]), np.abs(slopes[1])
    # A point has no width; a millionth of a pixel stands for none.
    return np.maximum(np.maximum(first, second), 1e-6), np.maximum(np.minimum(first, second), 1e-6)


def axis_matrix(places: ScreenMap, axis: str, *, supersampling: int, device_px: int, across_px: int) -> sp.csc_matrix:
    """Return the share of the light of each device column (or row) that reaches each camera pixel.

    Parameters
    ----------
    places : where the sub-rays meet the display.
    axis : "x" for device columns, "y" for device rows.
    device_px, across_px : panel size along this axis and across it.

    Returns
    -------
    float32 matrix [camera pixels, device_px], in columns, so that a stripe touches only the columns that it lights.
    """
    along, across = (places.column_px, places.row_px) if axis == "x" else (places.row_px, places.column_px)
    fine_columns = along.shape[1]
    along_slopes, across_slopes = local_slopes(along, places.route), local_slopes(across, places.route)
    bands = []
    band_rows = max(1, BAND_RAYS // (fine_columns * supersampling)) * supersampling
    for start in range(0, along.shape[0], band_rows):
        band = slice(start, start + band_rows)
        wide, narrow = _box_widths((across_slopes[0][band], across_slopes[1][band]))
        centre = np.nan_to_num(across[band], nan=-1e9)
        on_panel = trapezoid_share(across_px - 0.5 - centre, wide, narrow) - trapezoid_share(
            -0.5 - centre, wide, narrow
        )
        weight = on_panel * places.transmission[band] / supersampling**2
        slopes = (along_slopes[0][band], along_slopes[1][band])
        bands.append(_band_matrix(along[band], slopes, weight, supersampling, device_px))
    return sp.vstack(bands, format="csc", dtype=np.float32)


def _band_matrix(
    place: Grid, slopes: tuple[Grid, Grid], weight: Grid, supersampling: int, device_px: int
) -> sp.csr_matrix:
    """Spread some rows of sub-rays over the device columns."""
    rows, columns = place.shape
    pixels = (rows // supersampling) * (columns // supersampling)
    fine_row, fine_column = np.nonzero((weight > 0) & np.isfinite(place))
    pixel = ((fine_row // supersampling) * (columns // supersampling) + fine_column // supersampling).astype(np.int32)
    chosen = (fine_row, fine_column)
    place, weight = place[chosen], weight[chosen]
    wide, narrow = _box_widths((slopes[0][chosen], slopes[1][chosen]))
    half = 0.5 * (wide + narrow)
    reaches = (place + half > -0.5) & (place - half < device_px - 0.5)
    place, weight, wide, narrow, half, pixel = (array[reaches] for array in (place, weight, wide, narrow, half, pixel))
    first = np.floor(place - half + 0.5)
    pieces = (np.floor(place + half + 0.5) - first).astype(np.int64) + 1
    below = np.zeros(len(place))
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for number in range(int(pieces.max(initial=0))):
        more = pieces > number
        if not more.all():
            place, weight, wide, narrow, pixel, first, pieces, below = (
                array[more] for array in (place, weight, wide, narrow, pixel, first, pieces, below)
            )
        upto = trapezoid_share(first + number + 0.5 - place, wide, narrow)
        column = first + number
        inside = (column >= 0) & (column < device_px)
        share = (weight * (upto - below))[inside]
        parts.append((pixel[inside], column[inside].astype(np.int32), share.astype(np.float32)))
        below = upto
    return _sparse(parts, (pixels, device_px))


def _sparse(parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]], shape: tuple[int, int]) -> sp.csr_matrix:
    """Add up (row, column, share) triples."""
    if not parts:
        parts = [(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32))]
    row, column, share = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return sp.coo_matrix((share, (row, column)), shape=shape).tocsr()


def _sample_places(places: ScreenMap) -> tuple[list[tuple[float, float]], tuple[Grid, Grid], tuple[Grid, Grid]]:
    steps = (np.arange(IMAGE_SAMPLES) + 0.5) / IMAGE_SAMPLES - 0.5
    offsets = [(float(across), float(down)) for down in steps for across in steps]
    return offsets, local_slopes(places.column_px, places.route), local_slopes(places.row_px, places.route)


def image_light(
    places: ScreenMap, light: Float32[np.ndarray, "device_rows device_columns"], *, supersampling: int
) -> Float32[np.ndarray, "rows columns"]:
    """Return the light that each camera pixel gets from a whole image on the display."""
    device_rows, device_columns = light.shape
    padded = np.zeros((device_rows + 2, device_columns + 2), np.float32)
    padded[1:-1, 1:-1] = light
    offsets, column_slopes, row_slopes = _sample_places(places)
    fine_rows, fine_columns = places.column_px.shape
    total = np.zeros((fine_rows, fine_columns), np.float32)
    # A few rows at a time stay near the core.
    for start in range(0, fine_rows, IMAGE_ROWS):
        band = slice(start, start + IMAGE_ROWS)
        column = np.nan_to_num(places.column_px[band], nan=-9.0)
        row = np.nan_to_num(places.row_px[band], nan=-9.0)
        (column_across, column_down), (row_across, row_down) = (
            (one[0][band], one[1][band]) for one in (column_slopes, row_slopes)
        )
        for across, down in offsets:
            # 1.5: half a pixel to round, one for the dark frame round the panel.
            x = column + across * column_across + down * column_down + 1.5
            y = row + across * row_across + down * row_down + 1.5
            x = np.clip(x, 0, device_columns + 1).astype(np.int32)
            y = np.clip(y, 0, device_rows + 1).astype(np.int32)
            total[band] += padded[y, x]
    total *= places.transmission / len(offsets)
    fold = supersampling
    return total.reshape(fine_rows // fold, fold, fine_columns // fold, fold).mean(axis=(1, 3))


def patch_matrix(
    places: ScreenMap, *, column: int, row: int, columns: int, rows: int, supersampling: int
) -> sp.csr_matrix:
    """Return the share of the light of each pixel of a rectangle of the display that reaches each camera pixel.

    float32 [camera pixels, rows · columns of the rectangle].
    """
    offsets, column_slopes, row_slopes = _sample_places(places)
    reach_x = 0.5 * (np.abs(column_slopes[0]) + np.abs(column_slopes[1])) + 0.5
    reach_y = 0.5 * (np.abs(row_slopes[0]) + np.abs(row_slopes[1])) + 0.5
    x, y = places.column_px, places.row_px
    with np.errstate(invalid="ignore"):
        near = (x > column - reach_x) & (x < column + columns - 1 + reach_x)
        near &= (y > row - reach_y) & (y < row + rows - 1 + reach_y) & (places.transmission > 0)
    fine_row, fine_column = np.nonzero(near)
    wide = places.column_px.shape[1] // supersampling
    pixel = (fine_row // supersampling) * wide + fine_column // supersampling
    x, y = x[near] + 0.5 - column, y[near] + 0.5 - row
    slopes = [slope[near] for slope in (*column_slopes, *row_slopes)]
    weight = places.transmission[near] / (len(offsets) * supersampling**2)
    pixels = places.column_px.size // supersampling**2
    parts = []
    for across, down in offsets:
        i = np.floor(x + across * slopes[0] + down * slopes[1]).astype(np.int64)
        j = np.floor(y + across * slopes[2] + down * slopes[3]).astype(np.int64)
        inside = (i >= 0) & (i < columns) & (j >= 0) & (j < rows)
        parts.append((pixel[inside], (j * columns + i)[inside], weight[inside]))
    return _sparse(parts, (pixels, rows * columns))


def light_of(levels: UInt8[np.ndarray, "..."], gamma: float) -> Float32[np.ndarray, "..."]:
    """Turn drive levels into light, 0 to 1."""
    table = (np.arange(256) / 255) ** gamma
    return table.astype(np.float32)[levels]
