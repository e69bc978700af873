"""From a planned photo to what the display gets: drive levels, computed by ``recon``'s patterns."""

import numpy as np

from drivers.protocols import Frame
from recon.manifest import Axis
from recon.patterns import stripe_frame
from rig.config import RigConfig
from rig.plan import TakePhoto

LEVELS = {"white": 255, "black": 0}


def frame_of(photo: TakePhoto, config: RigConfig) -> Frame:
    """Return the frame of ``photo``: one stripe of its sweep, or the whole display lit or dark."""
    level = LEVELS.get(photo.sweep)
    if level is not None:
        return Frame(axis="x", levels=np.full(config.display.columns, level, dtype=np.uint8))
    axis: Axis = "x" if photo.sweep == "x" else "y"
    pattern_frame = stripe_frame(config.pattern(axis), axis, photo.index, device_px=config.device_px(axis))
    return Frame(axis=axis, levels=pattern_frame.levels)
