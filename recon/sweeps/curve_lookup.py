"""Each pixel's curve at its own samples, looked up in the table of all curves."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float64, Int64

from recon.sweeps.curve_samples import CurveSamples
from recon.sweeps.curve_table import NODE_SPACING, CurveTable
from recon.sweeps.stripe_walk import TableArrays, look_up_pixels

Looked = Float64[np.ndarray, "pixels samples"]


def looked_up(
    samples: CurveSamples,
    place: Float64[np.ndarray, " pixels"],
    log_width: Float64[np.ndarray, " pixels"],
    *,
    shape: Int64[np.ndarray, " pixels"],
    table: CurveTable,
) -> tuple[Looked, Looked, Looked]:
    """Return each pixel's curve at its samples, and the derivatives by place and by the width's logarithm.

    Widths are interpolated between two nodes; places are Taylor-expanded from the nearest entry.
    """
    log_width = np.ascontiguousarray(log_width)
    table.fill_about(shape, log_width)
    found = np.empty((3, len(place), samples.height.shape[1]))
    look_up_pixels(samples.peak, place - samples.peak_px, shape, log_width, table_arrays(table), found)
    return found[0], found[1], found[2]


@lru_cache(maxsize=4)
def table_arrays(table: CurveTable) -> TableArrays:
    """Return the table for compiled loops, which see the curves that are filled in later, too."""
    _, nodes, _, alignments, steps, _ = table.curves.shape
    return TableArrays(
        pairs=table.curves.reshape(-1).view(np.int64),
        nodes=nodes,
        alignments=alignments,
        steps=steps,
        alignment_of=table.alignment_of,
        pad=table.pad,
        entries_a_step=table.entries_a_step,
        spacing_px=table.spacing_px,
        reach_px=float(table.reach_px),
        step_px=float(table.pattern.step_px),
        thinnest=float(table.log_width[0]),
        node_spacing=NODE_SPACING,
    )
