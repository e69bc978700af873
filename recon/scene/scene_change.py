"""What changed in front of the camera between two reference photos: measured part by part, and named.

The photo has three parts that move differently. Marks are printed on the object's holder or on the tank's rim and seen
directly, whatever the display shows and wherever the liquid stands. Beside the object the display itself is seen, in the
wet sets through the liquid's surface. Through the object the display is seen once more.

=================  =======  ==========  ==============
what happened      marks    display     through object
=================  =======  ==========  ==============
camera moved       move     move alike  changes
object moved       move ¹   still       changes
display slipped    still    moves       changes
liquid not still   still    moves       still ²
light changed      still    brighter    brighter
=================  =======  ==========  ==============

¹ with marks on the holder; an object that slips in its holder changes alone. ² Light goes from the object straight into
the liquid and crosses no surface. Ripples also move the display's parts differently; a display that slips does not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool

from recon.scene.photo_noise import Photo, PhotoNoise
from recon.scene.scene_shift import PartShift, part_shift

Part = Literal["marks", "display", "object"]
Cause = Literal["camera", "object", "display", "liquid", "light", "camera or display", "camera or object"]
Mask = Bool[np.ndarray, "rows columns"]

# An edge that belongs to neither part, such as the object's rim, is kept out of both.
EDGE_PX = 3
# The camera moved if the display's picture went the marks' way for at least this share of it.
SAME_WAY = 0.4
# What is seen through the object stood still if it moved less than this share of what is seen beside it.
STILL_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class SceneParts:
    """Where the parts are in the photos, in photo px.

    ``object_px`` is a closed outline of (x, y) corners, empty where it is not known; ``marks_px`` are rectangles: first column,
    first row, last column, last row. All the rest is the display.
    """

    object_px: tuple[tuple[float, float], ...] = ()
    marks_px: tuple[tuple[float, float, float, float], ...] = ()

    def reduced(self, factor: int) -> "SceneParts":
        """Return where the parts are in photos that are ``factor`` times smaller."""

        def place(edge_px: float) -> float:
            return (edge_px + 0.5) / factor - 0.5

        return SceneParts(
            tuple((place(x), place(y)) for x, y in self.object_px),
            tuple((place(a), place(b), place(c), place(d)) for a, b, c, d in self.marks_px),
        )


@dataclass(frozen=True, slots=True)
class SceneLimits:
    """What is too much: a shift of ``shift_px`` photo px or a change of light of ``light_share``, both at least ``sigmas`` sd."""

    shift_px: float
    sigmas: float
    light_share: float


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that happened: its cause, the part that shows it, and how much: px with sd, or for light its share."""

    cause: Cause
    part: Part
    shift_px: float = 0.0
    sd_px: float = 0.0
    light: float = 0.0

    @property
    def text(self) -> str:
        """Say it in half a sentence."""
        if self.cause == "light":
            return f"the light changed by {100 * self.light:+.1f} %"
        size = f"{self.shift_px:.2f} px (sd {self.sd_px:.3f})"
        return {
            "camera": f"the camera moved: marks and display by {size}",
            "object": f"the object moved: {'its marks' if self.part == 'marks' else 'what is seen through it'} by {size}",
            "display": f"the display slipped: its picture moved by {size}",
            "liquid": f"the liquid is not still, or stands at another level: the display's picture moved by {size}",
            "camera or display": f"camera or display moved, which only marks could tell: the picture moved by {size}",
            "camera or object": f"camera or object moved: the marks by {size}",
        }[self.cause]


def part_masks(parts: SceneParts, *, rows: int, columns: int) -> dict[Part, Mask]:
    """Return the pixels of each part that is there; nearer to an edge than ``EDGE_PX`` belongs to none."""
    outline = np.zeros((rows, columns), np.uint8)
    if parts.object_px:
        cv2.fillPoly(outline, [np.rint(np.array(parts.object_px)).astype(np.int32)], 1)
    marks = np.zeros((rows, columns), np.uint8)
    for left, top, right, bottom in parts.marks_px:
        marks[round(top) : round(bottom) + 1, round(left) : round(right) + 1] = 1
    edge = np.ones((2 * EDGE_PX + 1,) * 2, np.uint8)
    masks: dict[Part, Mask] = {"display": (cv2.dilate(outline, edge) | cv2.dilate(marks, edge)) == 0}
    if parts.object_px:
        masks["object"] = (cv2.erode(outline, edge) > 0) & (cv2.dilate(marks, edge) == 0)
    if parts.marks_px:
        # Their outlines are drawn by hand: a pixel of margin, and all of the mark else, since it is small.
        masks["marks"] = cv2.erode(marks, np.ones((3, 3), np.uint8)) > 0
    return masks


def scene_change(first: Photo, second: Photo, masks: Mapping[Part, Mask], noise: PhotoNoise) -> dict[Part, PartShift]:
    """Measure every part between two photos of the same frame; parts without enough texture are left out."""
    measured = {part: part_shift(first, second, mask, noise) for part, mask in masks.items()}
    return {part: shift for part, shift in measured.items() if shift is not None}


def findings(
    change: Mapping[Part, PartShift],
    limits: SceneLimits,
    *,
    wet: bool,
    wanted: Sequence[Part] = ("marks", "display", "object"),
) -> tuple[Finding, ...]:
    """Name what happened; empty when nothing did that the limits call too much.

    ``wanted`` are the parts to look at: between sets only the marks may be compared.
    """
    seen = {part: shift for part, shift in change.items() if part in wanted}
    marks, display, through = seen.get("marks"), seen.get("display"), seen.get("object")
    found: list[Finding] = []
    if marks is not None and moved(marks, limits):
        found.append(_with_marks(marks, display))
    elif display is not None and (moved(display, limits) or uneven(display, limits)):
        found.append(_without_marks(display, through, limits, wet=wet, marks_are_still=marks is not None))
    elif through is not None and (moved(through, limits) or uneven(through, limits)):
        found.append(_finding("object", "object", through))
    lights = [(part, shift) for part, shift in seen.items() if part != "marks" or display is None]
    for part, shift in lights:
        if abs(shift.light) > limits.light_share and abs(shift.light) > limits.sigmas * shift.light_sd:
            found.append(Finding("light", part, light=shift.light))
            break
    return tuple(found)


def moved(shift: PartShift, limits: SceneLimits) -> bool:
    """Whether a part as a whole has moved."""
    return shift.length_px > limits.shift_px and shift.sigma > limits.sigmas


def uneven(shift: PartShift, limits: SceneLimits) -> bool:
    """Whether the blocks of a part have moved differently."""
    return shift.spread_px > limits.shift_px and shift.spread_sigma > limits.sigmas


def _finding(cause: Cause, part: Part, shift: PartShift) -> Finding:
    size_px = float(np.hypot(shift.length_px, shift.spread_px))
    return Finding(cause, part, shift_px=size_px, sd_px=float(np.hypot(*shift.sd_px) / np.sqrt(2)))


def _with_marks(marks: PartShift, display: PartShift | None) -> Finding:
    if display is None:
        return _finding("camera or object", "marks", marks)
    way = np.array(marks.shift_px)
    share = float(np.dot(display.shift_px, way) / np.dot(way, way))
    return _finding("camera" if share > SAME_WAY else "object", "marks", marks)


def _without_marks(
    display: PartShift, through: PartShift | None, limits: SceneLimits, *, wet: bool, marks_are_still: bool
) -> Finding:
    if wet and (_is_ripple(display) or (through is not None and _is_still_beside(through, display, limits))):
        return _finding("liquid", "display", display)
    return _finding("display" if marks_are_still else "camera or display", "display", display)


def _is_ripple(display: PartShift) -> bool:
    """Whether the blocks moved more differently than together; a display that slips moves them nearly alike."""
    return display.spread_px > display.length_px


def _is_still_beside(through: PartShift, display: PartShift, limits: SceneLimits) -> bool:
    """Whether what is seen through the object stood still while the display's picture moved.

    An object that makes the display's picture smaller also makes its shift smaller, which may then be below ``shift_px``.
    """
    sure = through.sigma > limits.sigmas or through.spread_sigma > limits.sigmas
    size_px, beside_px = (float(np.hypot(part.length_px, part.spread_px)) for part in (through, display))
    return not sure or size_px < STILL_SHARE * beside_px
