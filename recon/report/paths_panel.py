"""By how many light paths each pixel sees the display, as a map with its key."""

import numpy as np
from jaxtyping import Bool, UInt8

from recon.report.map_pictures import class_picture
from recon.report.panel import Panel

# Colour, name and meaning of each class of the map of light paths.
PATH_CLASSES = (
    ("#5c6773", "none", "saw the stripe in no sweep"),
    ("#2a9d8f", "one", "saw it once in every sweep that lit it"),
    ("#00b4d8", "two, with a point", "saw it twice in one sweep at least; one pair of its light paths meets"),
    ("#d1345b", "two, no point", "saw it twice in one sweep at least, and has no point for this or another reason"),
)


def paths_panel(
    path_count: UInt8[np.ndarray, "rows cols"], valid: Bool[np.ndarray, "rows cols"], *, longest_px: int
) -> Panel:
    """Return the map of the pixels that the stripe lit twice."""
    classes = np.where((path_count == 2) & ~valid, 3, path_count).astype(np.uint8)
    count_of = np.bincount(classes.ravel(), minlength=len(PATH_CLASSES)).tolist()
    return Panel(
        "paths",
        "How many light paths a pixel sees",
        "status.html.j2",
        {
            "picture": class_picture(
                classes,
                [colour for colour, _, _ in PATH_CLASSES],
                longest_px=longest_px,
                alt=f"Map of the light paths that each pixel sees; {count_of[2] + count_of[3]} pixels see two.",
            ),
            "rows": [(*one, count) for one, count in zip(PATH_CLASSES, count_of, strict=True)],
            "total": int(path_count.size),
        },
        "Where the stripe lit a pixel twice in one sweep, two light paths reach it. Their places are never averaged: the point "
        "is that of the paths with more light where these meet, of the only other pair that does where they do not.",
        "Two paths only in a thin line: the object's rim, or where light is refracted twice or reflected inside.",
        "Two paths all over: the display mirrored by the tank or a window, or a scene that moved during the sweep.",
    )
