"""Whether two frames light the panel alike."""

import numpy as np
import numpy.typing as npt

from drivers.protocols import Frame


def same_frame(one: Frame, other: Frame) -> bool:
    """Tell whether two frames light the panel alike, as far as their descriptions say."""
    if one is other:
        return True
    alike = one.axis == other.axis and _same(one.levels, other.levels) and _same(one.image, other.image)
    return (
        alike
        and len(one.patches) == len(other.patches)
        and all(
            (a.column, a.row) == (b.column, b.row) and _same(a.levels, b.levels)
            for a, b in zip(one.patches, other.patches, strict=True)
        )
    )


def _same(one: npt.NDArray[np.uint8] | None, other: npt.NDArray[np.uint8] | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other)
