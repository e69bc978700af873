"""How the surface bends about each pixel: the change of the normals over the points, by least squares over a window.

A light path that is off by noise meets the surface beside the place that the pixel's other measurements belong to. There the
normal is another one, and the surface lies below the tangent plane: both by the curvature.
"""

import cv2
import numpy as np
from jaxtyping import Float64

from recon.surface.ray_chords import Mask, VectorMap

WINDOW_PX = 9
# Share of a window's spread that no direction falls short of: a line of pixels says nothing across itself.
LINE = 1e-3
Tensors = Float64[np.ndarray, "rows cols 3 3"]


def curvature_of(point_mm: VectorMap, normal: VectorMap, used: Mask) -> Tensors:
    """Return K in 1/mm, tangential, so that a step d along the surface turns the normal by K d; 0 outside the mask."""
    mean_point = point_mm[used].mean(axis=0) if used.any() else np.zeros(3)
    place = np.where(used[..., None], point_mm - mean_point, 0.0)
    known = np.where(used[..., None], normal, 0.0)
    count = _window_mean(used.astype(np.float64)[..., None])
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_place, mean_normal = _window_mean(place) / count, _window_mean(known) / count
        spread = _products(place, place) / count[..., None] - mean_place[..., :, None] * mean_place[..., None, :]
        shared = _products(known, place) / count[..., None] - mean_normal[..., :, None] * mean_place[..., None, :]
        up = mean_normal / np.linalg.norm(mean_normal, axis=2, keepdims=True)
    result = np.zeros((*used.shape, 3, 3))
    flat = np.eye(3) - up[used][:, :, None] * up[used][:, None, :]
    inside = flat @ spread[used] @ flat
    size = np.trace(inside, axis1=1, axis2=2)[:, None, None]
    # A lone pixel spreads over nothing, and shows no bend.
    size = np.maximum(size, LINE * np.median(size)) + np.finfo(float).tiny
    # The normal's own direction is filled, so that the rest can be inverted.
    inverse = np.linalg.inv(inside / size + (np.eye(3) - flat) + LINE * np.eye(3))
    bent = flat @ (shared[used] / size) @ inverse @ flat
    result[used] = 0.5 * (bent + np.swapaxes(bent, 1, 2))
    return result


def _window_mean(fields: Float64[np.ndarray, "rows cols fields"]) -> Float64[np.ndarray, "rows cols fields"]:
    window = (WINDOW_PX, WINDOW_PX)
    mean = cv2.boxFilter(fields, cv2.CV_64F, window, borderType=cv2.BORDER_CONSTANT)
    return mean.reshape(fields.shape)


def _products(first: VectorMap, second: VectorMap) -> Tensors:
    outer = first[..., :, None] * second[..., None, :]
    return _window_mean(outer.reshape(*first.shape[:2], 9)).reshape(outer.shape)
