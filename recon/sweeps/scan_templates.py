"""The curves that scans compare samples with: rows of the table, with the entries of the scan's places alone."""

import numpy as np
from jaxtyping import Float64, Int64

from recon.sweeps.curve_table import SHAPES, CurveTable
from recon.sweeps.stripe_scan import COARSE_PLACES_A_STEP, FINE_PLACES_A_PX, HERMITE_NODES, Templates

# One shape of footprint does for finding where the walk starts.
COARSE_SHAPE = SHAPES.index((0.5, 0.5))


def coarse_templates(
    table: CurveTable, log_width: Float64[np.ndarray, " pixels"]
) -> tuple[Templates, Int64[np.ndarray, " pixels"]]:
    """Return the templates to find a start with, and each pixel's row among them."""
    node = table.nearest_node(log_width)
    return _templates(
        table, np.full_like(node, COARSE_SHAPE), node, spacing=table.entries_a_step // COARSE_PLACES_A_STEP
    )


def fine_templates(
    table: CurveTable,
    shape: Int64[np.ndarray, " pixels"],
    log_width: Float64[np.ndarray, " pixels"],
    sd: Float64[np.ndarray, " pixels"],
) -> tuple[Templates, Int64[np.ndarray, "pixels 3"]]:
    """Return the templates of each pixel's own shape and of the three widths of Hermite's rule, and its rows among them."""
    node = np.stack([table.nearest_node(log_width + shift * sd) for shift in HERMITE_NODES], axis=1)
    return _templates(table, np.broadcast_to(shape[:, None], node.shape), node, spacing=fine_spacing(table))


def fine_spacing(table: CurveTable) -> int:
    """Return how many entries lie between two places of the fine scan."""
    return int(min(table.pattern.step_px, 1.0) / FINE_PLACES_A_PX / table.spacing_px + 1e-6)


def _templates(
    table: CurveTable, shape: Int64[np.ndarray, "*pixels"], node: Int64[np.ndarray, "*pixels"], *, spacing: int
) -> tuple[Templates, Int64[np.ndarray, "*pixels"]]:
    wanted = np.zeros(table.filled.shape, dtype=bool)
    wanted[shape, node] = True
    table.fill(wanted)
    number = np.cumsum(wanted).reshape(wanted.shape) - 1
    first = table.middle_entry % spacing
    templates = Templates(
        rows=np.ascontiguousarray(table.value[..., first::spacing][wanted]),
        middle=table.middle_entry // spacing,
        places_a_step=table.entries_a_step // spacing,
        spacing_px=spacing * table.spacing_px,
        step_px=float(table.pattern.step_px),
        alignment_of=table.alignment_of,
        pad=table.pad,
    )
    return templates, number[shape, node]
