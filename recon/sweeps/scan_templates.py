"""The curves that scans compare samples with: rows of the table, with the entries of the scan's places alone."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float32, Float64, Int64

from recon.sweeps.curve_table import SHAPES, CurveTable
from recon.sweeps.stripe_scan import COARSE_PLACES_A_STEP, FINE_PLACES_A_PX, HERMITE_NODES, MOST_FINE_PLACES, Templates

# One shape of footprint does for finding where the walk starts.
COARSE_SHAPE = SHAPES.index((0.5, 0.5))
# What is less than this share of a curve's highest value is rounded away in sums of single precision.
DARK_SHARE = 1e-8


@lru_cache(maxsize=4)
def coarse_templates(table: CurveTable) -> Templates:
    """Return the templates to find a start with, one row for each node of the widths."""
    node = np.arange(len(table.log_width))
    templates, _ = _templates(
        table, np.full_like(node, COARSE_SHAPE), node, spacing=table.entries_a_step // COARSE_PLACES_A_STEP
    )
    return templates


def fine_templates(
    table: CurveTable,
    shape: Int64[np.ndarray, " pixels"],
    log_width: Float64[np.ndarray, " pixels"],
    sd: Float64[np.ndarray, " pixels"],
) -> tuple[Templates, Int64[np.ndarray, "3 pixels"]]:
    """Return the templates of each pixel's own shape and of the widths of Hermite's rule, and its rows among them.

    A width that is known well has one node, and one row: the others are -1.
    """
    node = np.stack([table.nearest_node(log_width + shift * sd) for shift in HERMITE_NODES])
    finest_px = max(min(table.pattern.step_px, 1.0) / FINE_PLACES_A_PX, table.flat_px / MOST_FINE_PLACES)
    spacing = int(finest_px / table.spacing_px + 1e-6)
    templates, row = _templates(table, np.broadcast_to(shape, node.shape), node, spacing=spacing)
    row[1:][node[1:] == node[0]] = -1
    return templates, row


def _templates(
    table: CurveTable, shape: Int64[np.ndarray, "*pixels"], node: Int64[np.ndarray, "*pixels"], *, spacing: int
) -> tuple[Templates, Int64[np.ndarray, "*pixels"]]:
    wanted = np.zeros(table.filled.shape, dtype=bool)
    wanted[shape, node] = True
    table.fill(wanted)
    number = np.cumsum(wanted).reshape(wanted.shape) - 1
    rows = table.values(wanted, first=table.middle_entry % spacing, spacing=spacing)
    templates = Templates(
        rows=rows.ravel(),
        lit=_lit(rows),
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
    return templates, number[shape, node]


def _lit(rows: Float32[np.ndarray, "rows alignments entries"]) -> Int64[np.ndarray, "rows 2"]:
    """Return the first and the last entry of each row where some curve is more than rounding leaves of it."""
    height = np.abs(rows).max(axis=1)
    lit = height > DARK_SHARE * height.max(axis=1, keepdims=True)
    return np.stack([lit.argmax(axis=1), lit.shape[1] - 1 - lit[:, ::-1].argmax(axis=1)], axis=1)
