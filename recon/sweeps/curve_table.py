"""All curves that a pixel can show for one pattern, computed once and looked up for every pixel.

A footprint is described by its total standard deviation (``width``) and its shape: which share of its variance is that of
two boxes (a square pixel under a locally affine map, ``stripe_model.py``), the rest being a Gaussian blur (lens, defocus,
display), and how the two boxes compare. Shapes are few and coarse, since the centre of a symmetric curve hardly depends on
them; widths are interpolated between closely spaced nodes, and places are Taylor-expanded from the nearest entry.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from recon.compiled import compiled
from recon.memory import zeros_taken_when_written
from recon.patterns.sweep_frames import device_brightness
from recon.sessions.manifest import StripePattern
from recon.sweeps.stripe_model import UNIT_BOX, footprint_average

SHARE_STEPS = 4
RATIO_STEPS = 16
# (share of the boxes in the variance, smaller box over larger box)
SHAPES = (
    (0.0, 0.0),
    *(
        (share / SHARE_STEPS, ratio / RATIO_STEPS)
        for share in range(1, SHARE_STEPS + 1)
        for ratio in range(RATIO_STEPS + 1)
    ),
)
# Widths between two nodes are interpolated linearly: an error below a thousandth of the curve's height.
NODE_SPACING = 0.1
# The second-order term that a lookup leaves out is below 3e-5 of the curvature at this many entries a step (or half a
# device pixel where steps are longer).
ENTRIES_A_STEP = 64
# Stripes stand on the device pixels in so many different ways; finer differences are rounded to an eighth of a pixel.
MOST_ALIGNMENTS = 8
THINNEST_PX = 0.03
GAUSSIAN_REACH_SD = 5.0


Curves = Float32[np.ndarray, "shapes nodes phases alignments steps 2"]


@dataclass(frozen=True, slots=True, eq=False)
class CurveTable:
    """The curves of one pattern: brightness 0 to 1 and its derivative by the distance, side by side.

    Entries a whole number of steps apart follow each other, for a pixel's samples show such: of ``entries_a_step`` phases, entry
    e is number e // phases of the phase e % phases.

    ``log_width`` are the width nodes, ``spacing_px`` and ``reach_px`` the spacing and range of the distances (from the stripe's
    centre to the footprint's), ``alignments_px`` the different places of a stripe's centre on its device pixel, and
    ``alignment_of`` tells for stripe numbers from ``-pad`` on which of them each has. On each side the entries go on for ``pad``
    stripes, as dark as at the end of the range. A curve is computed when it is first ``fill``-ed in.
    """

    pattern: StripePattern
    continuous: bool
    log_width: Float64[np.ndarray, " nodes"]
    spacing_px: float
    reach_px: float
    alignments_px: Float64[np.ndarray, " alignments"]
    alignment_of: Int64[np.ndarray, " stripes"]
    pad: int
    curves: Curves
    filled: Bool[np.ndarray, "shapes nodes"]

    def fill_about(
        self,
        shape: Int64[np.ndarray, " pixels"],
        log_width: Float64[np.ndarray, " pixels"],
        rows: Int64[np.ndarray, " some"] | None = None,
    ) -> None:
        """Compute the curves of these shapes whose widths are next to these, to either side; of some ``rows`` or of all."""
        rows = np.arange(len(shape)) if rows is None else rows
        thinnest = float(self.log_width[0])
        if misses_any(rows, shape, log_width, thinnest, NODE_SPACING, self.filled):
            wanted = np.zeros_like(self.filled)
            mark_wanted(rows, shape, log_width, thinnest, NODE_SPACING, wanted)
            self.fill(wanted)

    def fill(self, wanted: Bool[np.ndarray, "shapes nodes"]) -> None:
        """Compute the curves that are wanted, where that has not been done."""
        missing = wanted & ~self.filled
        if missing.any():
            for shape, node in np.argwhere(missing):
                self._fill_one(int(shape), int(node))

    def _fill_one(self, shape: int, node: int) -> None:
        phases, _, steps, _ = self.curves.shape[2:]
        dark = self.pad * phases
        for kind, offset_px in enumerate(self.alignments_px):
            both = _curve(float(np.exp(self.log_width[node])), shape, float(offset_px), self)
            for number, one in enumerate(both):
                padded = np.pad(one, (dark, phases * steps - dark - len(one)), mode="edge")
                self.curves[shape, node, :, kind, :, number] = padded.reshape(steps, phases).T
        self.filled[shape, node] = True

    def values(
        self, wanted: Bool[np.ndarray, "shapes nodes"], *, first: int, spacing: int
    ) -> Float32[np.ndarray, "rows alignments entries"]:
        """Return the brightness of the wanted curves, every ``spacing``-th entry from ``first`` on."""
        value = self.curves[:, :, first::spacing, ..., 0][wanted]
        return np.moveaxis(value, 1, -1).reshape(len(value), len(self.alignments_px), -1)

    @property
    def entries_a_step(self) -> int:
        """Return how many entries lie between two stripes."""
        return round(self.pattern.step_px / self.spacing_px)

    @property
    def flat_px(self) -> float:
        """Return over how many device pixels the sharpest footprint's place may not show in its curve.

        A hard stripe looks the same from anywhere within its step, any other one from anywhere within a device pixel.
        """
        step = self.pattern.step_px
        return step if self.pattern.profile == "hard" else min(step, 1.0)

    @property
    def middle_entry(self) -> int:
        """Return the entry of a distance of zero."""
        return round(self.reach_px / self.spacing_px) + self.pad * self.entries_a_step

    def nearest_node(self, log_width: Float64[np.ndarray, " pixels"]) -> Int64[np.ndarray, " pixels"]:
        """Return the number of the width node nearest to each width."""
        number = np.empty(len(log_width), dtype=np.int64)
        thinnest, last = float(self.log_width[0]), len(self.log_width) - 1
        write_nearest(np.ascontiguousarray(log_width), thinnest, NODE_SPACING, last, number)
        return number


@compiled
def write_nearest(log_width: np.ndarray, thinnest: float, spacing: float, last: int, number: np.ndarray) -> None:
    """Write the numbers of the nodes nearest to some widths."""
    for pixel in range(np.uintp(len(number))):
        nearest = np.rint((log_width[pixel] - thinnest) / spacing)
        number[pixel] = int(min(nearest if nearest > 0.0 else 0.0, float(last)))


@compiled
def misses_any(
    rows: np.ndarray, shape: np.ndarray, log_width: np.ndarray, thinnest: float, spacing: float, filled: np.ndarray
) -> bool:
    """Return whether some curve [shapes, nodes] beside the widths of some rows is not filled in."""
    last = float(filled.shape[1] - 2)
    missing = False
    for number in range(np.uintp(len(rows))):
        row = np.uintp(rows[number])
        below = (log_width[row] - thinnest) / spacing
        # What is no number has a place in the table, too.
        one, node = np.uintp(shape[row]), np.uintp(min(below if below > 0.0 else 0.0, last))
        missing |= not (filled[one, node] & filled[one, node + np.uintp(1)])
    return missing


@compiled
def mark_wanted(
    rows: np.ndarray, shape: np.ndarray, log_width: np.ndarray, thinnest: float, spacing: float, wanted: np.ndarray
) -> None:
    """Mark the curves [shapes, nodes] beside the widths of some rows."""
    last = wanted.shape[1] - 2
    for row in rows:
        below = (log_width[row] - thinnest) / spacing
        node = min(int(below), last) if below > 0.0 else 0
        wanted[shape[row], node] = wanted[shape[row], node + 1] = True


@lru_cache(maxsize=4)
def curve_table(pattern: StripePattern, *, half_width: int, continuous: bool) -> CurveTable:
    """Return the table for windows of ``half_width`` samples on each side; the sweeps of a session share one.

    ``continuous`` is for scenes whose stripe was drawn as a function and not on device pixels.
    """
    step = pattern.step_px
    # A whole number of entries lies between two stripes, so that a scan over places is a slice.
    spacing = step / (ENTRIES_A_STEP * max(1, int(np.ceil(step / 2))))
    reach = spacing * np.ceil(((half_width + 2) * step + 2 * max(step, 1.0)) / spacing)
    widest = (half_width + 1) * step
    thinnest = THINNEST_PX * min(step, 1.0)
    nodes = int(np.ceil(np.log(widest / thinnest) / NODE_SPACING)) + 1
    log_width = np.log(thinnest) + NODE_SPACING * np.arange(nodes)
    pad = half_width + 1
    alignments, alignment_of = _alignments(pattern, pad=pad, continuous=continuous)
    phases = round(step / spacing)
    steps = 2 * pad + -(-(round(2 * reach / spacing) + 1) // phases)
    # Most shapes are never filled in.
    curves = zeros_taken_when_written((len(SHAPES), nodes, phases, len(alignments), steps, 2), np.float32)
    return CurveTable(
        pattern=pattern,
        continuous=continuous,
        log_width=log_width,
        spacing_px=float(spacing),
        reach_px=float(reach),
        alignments_px=alignments,
        alignment_of=alignment_of,
        pad=pad,
        curves=curves,
        filled=np.zeros((len(SHAPES), nodes), dtype=bool),
    )


def _alignments(pattern: StripePattern, *, pad: int, continuous: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the different places of a stripe's centre on its device pixel, and which of them each stripe has."""
    number = np.arange(-pad, pattern.count + pad)
    if continuous:
        return np.zeros(1), np.zeros(len(number), dtype=np.int64)
    offset = np.round(pattern.first_px + pattern.step_px * number, 6)
    offset = offset - np.floor(offset + 1e-9)
    kinds, kind = np.unique(np.round(offset, 5), return_inverse=True)
    if len(kinds) > MOST_ALIGNMENTS:
        kinds, kind = np.unique(np.round(offset * MOST_ALIGNMENTS) / MOST_ALIGNMENTS % 1.0, return_inverse=True)
    return kinds, kind.astype(np.int64)


def shape_of(
    box_px: Float64[np.ndarray, "pixels 2"] | Float32[np.ndarray, "pixels 2"], width_px: Float64[np.ndarray, " pixels"]
) -> Int64[np.ndarray, " pixels"]:
    """Return the number of the shape nearest to two boxes inside a footprint of this total standard deviation."""
    shape = np.empty(len(width_px), dtype=np.int64)
    write_shapes(box_px, width_px, shape)
    return shape


@compiled
def write_shapes(box_px: np.ndarray, width_px: np.ndarray, shape: np.ndarray) -> None:
    """Write the numbers of the shapes nearest to two boxes each [pixels, 2] inside footprints of these widths."""
    for pixel in range(len(shape)):
        by_col, by_row = float(box_px[pixel, 0]), float(box_px[pixel, 1])
        large, small, width = max(by_col, by_row), min(by_col, by_row), max(width_px[pixel], 1e-12)
        share_step = int(np.rint(min((large * large + small * small) / 12 / (width * width), 1.0) * SHARE_STEPS))
        ratio_step = int(np.rint(small / max(large, 1e-12) * RATIO_STEPS))
        shape[pixel] = 0 if share_step == 0 else 1 + (share_step - 1) * (RATIO_STEPS + 1) + ratio_step


def _curve(width_px: float, shape: int, offset_px: float, table: CurveTable) -> tuple[np.ndarray, np.ndarray]:
    """Return value and slope at all distances for one width, shape and alignment."""
    count = round(2 * table.reach_px / table.spacing_px) + 1
    if table.continuous:
        return _blurred(width_px, shape, table.pattern, spacing_px=table.spacing_px, half_count=(count - 1) // 2)
    half = (count - 1) // 2
    lit = np.arange(
        np.ceil(offset_px - table.pattern.width_px / 2 - 0.5),
        np.floor(offset_px + table.pattern.width_px / 2 + 0.5) + 1,
    )
    level = device_brightness(lit - offset_px, table.pattern)
    shift = np.rint((lit - offset_px) / table.spacing_px).astype(np.int64)
    margin = int(np.abs(shift).max()) + 1
    share, share_slope = _blurred(width_px, shape, UNIT_BOX, spacing_px=table.spacing_px, half_count=half + margin)
    value, slope = np.zeros(count), np.zeros(count)
    for one, by in zip(level, shift, strict=True):
        part = slice(margin - by, margin - by + count)
        value += one * share[part]
        slope += one * share_slope[part]
    return value, slope


def _blurred(
    width_px: float, shape: int, pattern: StripePattern, *, spacing_px: float, half_count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the profile averaged over a footprint, and its derivative, at ``2 * half_count + 1`` distances."""
    share, ratio = SHAPES[shape]
    large = np.sqrt(12 * share / (1 + ratio**2)) * width_px
    sigma = np.sqrt(1 - share) * width_px
    margin = int(np.ceil(GAUSSIAN_REACH_SD * sigma / spacing_px)) + 1
    x = spacing_px * np.arange(-half_count - margin, half_count + margin + 1.0)
    value, slope = footprint_average(x[None, :], np.array([large]), np.array([ratio * large]), pattern)
    both = np.concatenate([value, slope])
    if sigma > 0:
        # The derivative is taken after the blur: that of a sharp edge is too thin for the entries.
        count = next_fast_len(len(x), real=True)
        frequency = 2 * np.pi * rfftfreq(count, spacing_px)
        blurred = rfft(value[0], count) * np.exp(-0.5 * (frequency * sigma) ** 2)
        both = irfft(np.stack([blurred, 1j * frequency * blurred]), count)
    inner = both[:, margin : margin + 2 * half_count + 1]
    return inner[0], inner[1]
