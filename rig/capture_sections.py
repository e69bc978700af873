"""Sections of the configuration that make a capture shorter or safer: each may be left out."""

from typing import Annotated

from pydantic import Field

from recon.manifest import Part, Positive

Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
PhotoPixel = Annotated[int, Field(ge=0)]


class Scan(Part):
    """A few photos at the beginning of each set that find the part of the display that is seen; only that part is swept.

    ``seen_px`` is the part of the photos that counts (first column, first row, last column, last row), such as the object's
    outline; without it every lit pixel counts.
    """

    seen_px: tuple[PhotoPixel, PhotoPixel, PhotoPixel, PhotoPixel] | None = None


class Live(Part):
    """Each sweep is decoded while the next is photographed, and one beyond these limits is photographed again.

    The limits are judgements: good sweeps of the simulated scenes match 94 to 99 % of their lit pixels with contrasts of 0.98,
    a misfit of 2 to 3 for a smooth stripe and of 8 for a hard one.
    """

    least_coverage: Share = 0.7
    largest_saturated_share: Share = 0.05
    least_contrast: Share = 0.3
    largest_misfit: Positive = 30.0
    largest_dark_share: Share = 0.1
    object_distance_mm: Positive | None = None
    largest_entry_sd_mm: Positive | None = None
    attempts: Annotated[int, Field(ge=1)] = 2
    page_port: Annotated[int, Field(ge=0, le=65535)] = 0
