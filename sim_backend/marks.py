"""Printed marks above the liquid, which the camera sees directly: rings on the object's holder or on the tank's rim."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from sim_backend.light_paths import look
from sim_backend.scene import Scene
from sim_backend.scene_parts import SceneMarks

Values = Float32[np.ndarray, "rows columns"]
# The rings are soft in print, so that a few rays in each pixel measure them to a small part of a pixel.
RINGS = 2
# Side of a mark as a share of the photo's width, and how far from the photo's border it begins.
SHARE_OF_PHOTO = 0.1
BORDER_SHARE = 0.01
# How much nearer to the camera than the object's own plane, as a share of the way.
ABOVE_OBJECT = 0.05


def with_marks(scene: Scene) -> Scene:
    """Return the scene with four marks on the object's holder, one in each corner of the photo."""
    camera = scene.camera
    away_mm = -camera.position_mm[2] * (1 - ABOVE_OBJECT)
    radius_px = SHARE_OF_PHOTO / 2 * camera.columns
    inset_px = BORDER_SHARE * camera.columns + radius_px
    corners = [
        (column, row)
        for row in (inset_px - 0.5, camera.rows - inset_px - 0.5)
        for column in (inset_px - 0.5, camera.columns - inset_px - 0.5)
    ]
    centres = tuple(
        (
            camera.position_mm[0] + away_mm * (column - camera.centre_x_px) / camera.focal_x_px,
            camera.position_mm[1] + away_mm * (row - camera.centre_y_px) / camera.focal_y_px,
        )
        for column, row in corners
    )
    marks = SceneMarks(
        centres_mm=centres, height_mm=camera.position_mm[2] + away_mm, radius_mm=radius_px * away_mm / camera.focal_x_px
    )
    return scene.model_copy(update={"marks": marks})


def marks_seen_px(scene: Scene) -> tuple[tuple[float, float, float, float], ...]:
    """Return the square around each mark in the photo: first column, first row, last column, last row."""
    marks, camera = scene.marks, scene.camera
    if marks is None:
        return ()
    squares = []
    away_mm = marks.height_mm - camera.position_mm[2]
    for x_mm, y_mm in marks.centres_mm:
        column = camera.centre_x_px + camera.focal_x_px * (x_mm - camera.position_mm[0]) / away_mm
        row = camera.centre_y_px + camera.focal_y_px * (y_mm - camera.position_mm[1]) / away_mm
        reach_x, reach_y = (marks.radius_mm / away_mm * focal for focal in (camera.focal_x_px, camera.focal_y_px))
        squares.append(
            (
                max(0.0, column - reach_x),
                max(0.0, row - reach_y),
                min(camera.columns - 1.0, column + reach_x),
                min(camera.rows - 1.0, row + reach_y),
            )
        )
    return tuple(squares)


def mark_light(scene: Scene, *, shift_mm: Sequence[float] = (0.0, 0.0)) -> tuple[Values, Values] | None:
    """Return what share of each pixel the marks cover, and the share of full scale that they send there; None without marks.

    ``scene`` is the disturbed one, ``shift_mm`` (x, y) how far the marks themselves have moved. A mark is a square of black
    paper; the reflectance of its rings at the distance r from its centre is ½ (1 − cos(2π r rings / radius)).
    """
    marks, camera = scene.marks, scene.camera
    if marks is None:
        return None
    fold = camera.supersampling
    row, column = np.indices((camera.rows * fold, camera.columns * fold)).reshape(2, -1)
    direction = look(camera, (column + 0.5) / fold - 0.5, (row + 0.5) / fold - 0.5)
    away = (marks.height_mm - camera.position_mm[2]) / direction[:, 2]
    x_mm = camera.position_mm[0] + away * direction[:, 0] - shift_mm[0]
    y_mm = camera.position_mm[1] + away * direction[:, 1] - shift_mm[1]
    covered = np.zeros(len(away), np.float32)
    light = np.zeros(len(away), np.float32)
    for centre_x_mm, centre_y_mm in marks.centres_mm:
        right, down = (x_mm - centre_x_mm) / marks.radius_mm, (y_mm - centre_y_mm) / marks.radius_mm
        covered[(np.abs(right) <= 1) & (np.abs(down) <= 1)] = 1
        r = np.hypot(right, down)
        inside = r <= 1
        light[inside] = marks.light * 0.5 * (1 - np.cos(2 * np.pi * RINGS * r[inside]))
    shape = (camera.rows, fold, camera.columns, fold)
    return covered.reshape(shape).mean(axis=(1, 3)), light.reshape(shape).mean(axis=(1, 3))
