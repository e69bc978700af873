"""Compiled loops over a tile's patch: how far draws turn its normals, and what of it is taken over into the maps."""

import numpy as np

from recon.compiled import compiled


@compiled
def add_moves(slopes: np.ndarray, rate: np.ndarray, error: np.ndarray, result: np.ndarray) -> None:
    """Write ``slopes`` [2, draws, rows, cols] and what moves add to them: ``rate`` [axes, 2, rows, cols] times ``error``.

    The latter [axes, draws, rows, cols] are those of the lateral place.
    """
    draws, rows, cols = slopes.shape[1:]
    for along in range(2):
        for draw in range(draws):
            for row in range(rows):
                for col in range(cols):
                    change = rate[0, along, row, col] * error[0, draw, row, col]
                    change += rate[1, along, row, col] * error[1, draw, row, col]
                    result[along, draw, row, col] = slopes[along, draw, row, col] + change


@compiled
def mean_tilt_squared(
    slopes: np.ndarray,
    normal: np.ndarray,
    length: np.ndarray,
    result: np.ndarray,
) -> None:
    """Write the mean square of the angles by which changes ``slopes`` [2, draws, rows, cols] turn the normal; 0 without any.

    Of the ``normal`` the parts along both axes are given, and the ``length`` that its slopes were divided by. Windows that tell
    hardly anything have slopes beyond all numbers; NaN says that they are no good.
    """
    rows, cols = length.shape
    draws = slopes.shape[1]
    n_p, n_q = np.empty(cols, slopes.dtype), np.empty(cols, slopes.dtype)
    squares, along = np.empty(cols, slopes.dtype), np.empty(cols, slopes.dtype)
    for row in range(rows):
        for col in range(cols):
            n_p[col], n_q[col] = normal[0, row, col], normal[1, row, col]
            squares[col], along[col] = 0.0, 0.0
        for draw in range(draws):
            for col in range(cols):
                one, other = slopes[0, draw, row, col], slopes[1, draw, row, col]
                share = one * n_p[col] + other * n_q[col]
                squares[col] += one * one + other * other
                along[col] += share * share
        for col in range(cols):
            left = np.float64(squares[col] - along[col])
            # Written so that NaN stays.
            result[row, col] = 0.0 if left < 0.0 else left / (max(draws, 1) * (length[row, col] * length[row, col]))


@compiled
def take_over(
    held: np.ndarray,
    place: np.ndarray,
    tilt: np.ndarray,
    spread: np.ndarray,
    across: np.ndarray,
    turn: np.ndarray,
    left: np.ndarray,
    frame: np.ndarray,
    middle_mm: np.ndarray,
    unit_mm: float,
    half_width: int,
    corner: tuple[int, int],
    point_mm: np.ndarray,
    normal: np.ndarray,
    sd_mm: np.ndarray,
    across_sd_mm: np.ndarray,
    normal_sd_rad: np.ndarray,
    left_rad2: np.ndarray,
    half_width_px: np.ndarray,
) -> None:
    """Write points (``place``) and normals (``tilt``) of a tile into the maps from ``corner`` on, where ``held`` and surer.

    Their sds are ``spread``, its part ``across`` the surface, and ``turn``, whose square holds ``left`` of bias; points, and
    their sds, are given in the tile's own ``frame`` and unit.
    """
    for row in range(held.shape[0]):
        for col in range(held.shape[1]):
            if not held[row, col]:
                continue
            down, right = corner[0] + row, corner[1] + col
            if unit_mm * spread[row, col] < sd_mm[down, right]:
                p, q, height = place[row, col, 0], place[row, col, 1], place[row, col, 2]
                for axis in range(3):
                    moved = unit_mm * p * frame[0, axis] + unit_mm * q * frame[1, axis]
                    point_mm[down, right, axis] = middle_mm[axis] + (moved + unit_mm * height * frame[2, axis])
                sd_mm[down, right] = unit_mm * spread[row, col]
                across_sd_mm[down, right] = unit_mm * across[row, col]
            if turn[row, col] < normal_sd_rad[down, right]:
                p, q, height = tilt[row, col, 0], tilt[row, col, 1], tilt[row, col, 2]
                for axis in range(3):
                    turned = p * frame[0, axis] + q * frame[1, axis]
                    normal[down, right, axis] = turned + height * frame[2, axis]
                normal_sd_rad[down, right] = turn[row, col]
                left_rad2[down, right] = left[row, col]
                half_width_px[down, right] = half_width
