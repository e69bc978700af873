"""The curves that scans compare samples with: rows of the table, with the entries of the scan's places alone."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float32, Float64, Int64

from recon.sweeps.curve_table import NODE_SPACING, SHAPES, CurveTable
from recon.sweeps.stripe_scan import COARSE_PLACES_A_STEP, FINE_PLACES_A_PX, HERMITE_NODES, MOST_FINE_PLACES, Templates

# One shape of footprint does for finding where the walk starts.
COARSE_SHAPE = SHAPES.index((0.5, 0.5))
# Between two nodes of the table widths are interpolated, so finely: a wide footprint leaves an interval that hangs on its width.
WIDTHS_A_NODE = 4


@lru_cache(maxsize=4)
def coarse_templates(table: CurveTable) -> Templates:
    """Return the templates to find a start with, one row for each node of the widths."""
    wanted = np.zeros_like(table.filled)
    wanted[COARSE_SHAPE] = True
    table.fill(wanted)
    spacing = table.entries_a_step // COARSE_PLACES_A_STEP
    return _templates(table, table.value[COARSE_SHAPE, :, :, table.middle_entry % spacing :: spacing], spacing=spacing)


def fine_templates(
    table: CurveTable,
    shape: Int64[np.ndarray, " pixels"],
    log_width: Float64[np.ndarray, " pixels"],
    sd: Float64[np.ndarray, " pixels"],
) -> tuple[Templates, Int64[np.ndarray, "3 pixels"]]:
    """Return the templates of each pixel's own shape and of the widths of Hermite's rule, and its rows among them.

    A width that is known well has one row: the others are -1.
    """
    last = WIDTHS_A_NODE * (len(table.log_width) - 1) - 1
    nodes = [(log_width + shift * sd - table.log_width[0]) / NODE_SPACING for shift in HERMITE_NODES]
    width = np.clip(np.rint(WIDTHS_A_NODE * np.array(nodes)), 0, last).astype(np.int64)
    wanted = np.zeros((len(table.filled), last + 1), dtype=bool)
    wanted[shape, width] = True
    number = np.cumsum(wanted).reshape(wanted.shape) - 1
    finest_px = max(min(table.pattern.step_px, 1.0) / FINE_PLACES_A_PX, table.flat_px / MOST_FINE_PLACES)
    spacing = int(finest_px / table.spacing_px + 1e-6)
    value = table.value[..., table.middle_entry % spacing :: spacing]
    of_shape, node_part = np.nonzero(wanted)
    node, part = np.divmod(node_part, WIDTHS_A_NODE)
    filled = np.zeros_like(table.filled)
    filled[of_shape, node] = filled[of_shape, node + 1] = True
    table.fill(filled)
    share = (part / WIDTHS_A_NODE).astype(np.float32)[:, None, None]
    rows = (1 - share) * value[of_shape, node] + share * value[of_shape, node + 1]
    row = number[shape, width]
    row[1:][width[1:] == width[0]] = -1
    return _templates(table, rows, spacing=spacing), row


def _templates(table: CurveTable, rows: Float32[np.ndarray, "rows alignments entries"], *, spacing: int) -> Templates:
    return Templates(
        rows=rows.ravel(),
        alignments=rows.shape[1],
        entries=rows.shape[2],
        middle=table.middle_entry // spacing,
        places_a_step=table.entries_a_step // spacing,
        spacing_px=spacing * table.spacing_px,
        step_px=float(table.pattern.step_px),
        flat_px=float(table.flat_px),
        alignment_of=table.alignment_of,
        pad=table.pad,
    )
