"""Each pixel's curve at its own samples, looked up in the table of all curves."""

import numpy as np
from jaxtyping import Float32, Float64, Int64

from recon.sweeps.curve_samples import CurveSamples
from recon.sweeps.curve_table import NODE_SPACING, CurveTable

Looked = Float32[np.ndarray, "samples pixels"]


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
    _, nodes, kinds, entries = table.value.shape
    node = np.clip(((log_width - table.log_width[0]) / NODE_SPACING).astype(np.int64), 0, nodes - 2)
    table.fill_between(shape, node)
    share = np.clip((log_width - table.log_width[node]) / NODE_SPACING, 0.0, 1.0).astype(np.float32)
    distance = place - samples.peak_px
    entry = table.entry(distance)
    rest = distance + table.reach_px - (entry - table.pad * table.entries_a_step) * table.spacing_px
    offset = np.arange(-samples.half_width, samples.half_width + 1)[:, None]
    index = entry + (shape * nodes + node) * (kinds * entries) - table.entries_a_step * offset
    if kinds > 1:
        index += table.alignment_of[samples.peak + offset + table.pad] * entries
    curve, slope, by_width, part = (
        one.ravel().take(index) for one in (table.value, table.slope, table.wider, table.wider_slope)
    )
    part *= share
    slope += part
    curve += np.multiply(share, by_width, out=part)
    curve += np.multiply(rest.astype(np.float32), slope, out=part)
    by_width *= np.float32(1 / NODE_SPACING)
    return curve, slope, by_width
