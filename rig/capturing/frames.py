"""From a planned photo to what the display gets: drive levels, computed by ``recon``'s patterns."""

from functools import lru_cache

import numpy as np

from drivers.protocols import Frame, Patch
from recon.calibration.board import BOARD, board_for_display
from recon.patterns.coarse_scan import scan_levels, scan_name
from recon.patterns.frame_tag import LARGEST_NUMBER, tag_levels
from recon.patterns.pattern_frames import pattern_frame
from recon.patterns.reference_frame import reference_levels
from recon.scene.scene_check import REFERENCE, reduction
from recon.scene.scene_error import photo_scale_mm
from recon.sessions.manifest import Axis
from rig.config import RigConfig
from rig.planning.steps import TakePhoto

LEVELS = {"white": 255, "black": 0}
SCANNED: dict[str, Axis] = {scan_name("x"): "x", scan_name("y"): "y"}
# The finest detail of the reference frame in photo pixels as they are measured: fine enough to measure by, coarse enough
# for any lens.
FINEST_PHOTO_PX = 8.0


def frame_of(photo: TakePhoto, config: RigConfig) -> Frame:
    """Return the frame of ``photo``: one of its sweep, or the whole display lit or dark, with its tag if any."""
    patches = tag_patches(photo.frame_id, config)
    level = LEVELS.get(photo.sweep)
    if level is not None:
        return Frame(axis="x", levels=np.full(config.display.columns, level, dtype=np.uint8), patches=patches)
    scanned: Axis | None = SCANNED.get(photo.sweep)
    if scanned is not None:
        bits = scan_levels(config.stripe_pattern(scanned), photo.index, device_px=config.device_px(scanned))
        return Frame(axis=scanned, levels=bits, patches=patches)
    if photo.sweep == REFERENCE:
        size = (config.display.columns, config.display.rows)
        return Frame(image=_reference_image(*size, reference_finest_px(config)), patches=patches)
    if photo.sweep == BOARD:
        return Frame(image=board_image(config), patches=patches)
    axis: Axis = "x" if photo.sweep == "x" else "y"
    shown = pattern_frame(config.pattern(axis), axis, photo.index, device_px=config.device_px(axis))
    return Frame(axis=axis, levels=shown.levels, patches=patches)


def reference_finest_px(config: RigConfig) -> float:
    """Return the finest detail of the reference frame in device pixels.

    It is configured, or follows from the camera's distance and focal length; for a camera that was not calibrated the
    display is taken to fill the photo.
    """
    if config.watch is not None and config.watch.finest_px is not None:
        return config.watch.finest_px
    finest_photo_px = FINEST_PHOTO_PX * reduction(config.camera.columns)
    scales_mm = [photo_scale_mm(config.camera, pose) for pose in config.display_poses]
    if scales_mm[0] is None or scales_mm[1] is None:
        return finest_photo_px * config.display.columns / config.camera.columns
    return finest_photo_px * max(scales_mm[0], scales_mm[1]) / config.display.pitch_mm


def board_image(config: RigConfig) -> np.ndarray:
    """Return the drive levels [rows, columns] of the board that is shown in each set."""
    wanted = config.capture.board
    assert wanted is not None, "a plan has photos of a board only where the configuration asks for them"
    return board_for_display(config.display, squares_along=wanted.squares_along).image


@lru_cache(maxsize=1)
def _reference_image(columns: int, rows: int, finest_px: float) -> np.ndarray:
    return reference_levels(columns=columns, rows=rows, finest_px=finest_px)


def tag_number(frame_id: int) -> int:
    """Return the number that a frame's tag shows: numbers begin again where the tag's bits are used up."""
    return frame_id % (LARGEST_NUMBER + 1)


def tag_patches(frame_id: int, config: RigConfig) -> tuple[Patch, ...]:
    """Return the tag of a frame; it is drawn over the stripe, so that no stripe enters its square."""
    tag = config.frame_tag
    if tag is None:
        return ()
    return (Patch(column=tag.column, row=tag.row, levels=tag_levels(tag_number(frame_id), cell_px=tag.cell_px)),)
