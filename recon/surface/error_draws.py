"""What draws of the measurements' noise do to a fused surface, from which its standard deviations come.

The equations need not be weighted by the true covariance of their noise for this to be the true spread of their answer: a normal
serves two pairs on its line, and the distance comes from the same correspondences as the normal.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from jaxtyping import Float, Float16, Float32, Float64

from recon.compiled import compiled
from recon.memory import give_back_free_memory
from recon.surface.block_loops import COLUMNS
from recon.surface.block_solver import Block
from recon.surface.neighbours import Neighbours
from recon.surface.ray_chords import Chords, Mask, PerPair, PerPixel, Rays, ScalarMap
from recon.surface.steady_pulls import Pulls

# Standard deviations are estimated from this many draws over this window: good to a tenth or better.
DRAWS = 3 * COLUMNS
DRAW_WINDOW_PX = 9
DRAW_TOLERANCE = 1e-2  # of a draw, of which twelve tell an sd to a tenth
DRAW_SEED = 20180601
# No path slides as far on an object that a tank holds; half precision ends at 65,504.
FARTHEST_MM = np.float32(1e4)

# The noise of normals alone, of which all pixels have their own, over so many pixels.
TURN_WINDOW_PX = 17

SomePixels = Float32[np.ndarray, " pixels"]
SomeVectors = Float32[np.ndarray, "pixels 3"]
# Draws one error of every used pixel's distance and of its normal from the noise of its measurement, by how much its path
# slides along the surface, and the normal's error as that of the place where the pixel looks.
NoiseDraw = Callable[[np.random.Generator], tuple[SomePixels, SomeVectors, SomeVectors, SomeVectors]]
# Prepares such draws for a surface at the distances given, and the used pixels.
NoiseAt = Callable[[ScalarMap, Mask], NoiseDraw]


def drawn_errors(
    graph: Neighbours,
    chords: Chords,
    pulls: Pulls,
    prepared: Callable[[], Callable[[Block], Block]],
    noise: NoiseDraw,
    *,
    across: Float64[np.ndarray, "2 3"],
    weights: tuple[PerPair, PerPixel],
    scales: tuple[float, float],
    threads: int,
) -> tuple[
    Float32[np.ndarray, "draws rows cols"],
    Float16[np.ndarray, "2 draws rows cols"],
    Float16[np.ndarray, "3 draws rows cols"],
    PerPixel,
]:
    """Return what draws of noise do to the distances, through the very equations that were solved.

    Beside that, how far the paths slide in these draws ``across`` the sight, by how much the pixels' own normals turn, and the
    mean square of the errors of normals that were drawn for the equations.

    Parameters
    ----------
    prepared
        Makes ready what solves the equations, for some right sides at a time.
    across
        Two unit vectors across the mean line of sight.
    weights
        Those of the chords and of the measured distances.
    scales
        By how much the noise of distances, and of normals, is larger than was said.
    threads
        With more than one, the solver is made ready while the first set is drawn, a set is solved while the next is drawn, and
        a draw is made while the right side of the one before is written.
    """
    rng = np.random.default_rng(DRAW_SEED)
    places = np.flatnonzero(graph.mask)
    # Half precision tells lengths and angles to a thousandth, and memory is what a large surface lacks here.
    slides = np.zeros((2, DRAWS, *graph.mask.shape), np.float16)
    own_turns = np.zeros((3, DRAWS, *graph.mask.shape), np.float16)
    turned_squared, own = np.zeros(len(places)), np.empty(len(places))
    turned = np.empty((2, len(graph.first)), np.float32)
    errors = np.full((DRAWS, *graph.mask.shape), np.nan, np.float32)
    bend = chords.bend
    jobs = []
    drawn = _drawn(noise, rng, threads=threads)

    def solve_set(first: int, right: Block) -> None:
        for number, found in enumerate(solve.result()(right).T):
            errors[first + number].reshape(-1)[places] = found

    with ThreadPoolExecutor(1) as pool:
        solve = pool.submit(prepared)
        if threads == 1:
            solve.result()
        for first in range(0, DRAWS, COLUMNS):
            right = np.empty((len(places), COLUMNS), np.float32)
            for column in range(COLUMNS):
                distance_error, normal_error, slide, own_turn = next(drawn)
                for axis in (0, 1):
                    moved = slide @ across[axis].astype(np.float32)
                    slides[axis, first + column].reshape(-1)[places] = np.clip(moved, -FARTHEST_MM, FARTHEST_MM)
                for axis in range(3):
                    own_turns[axis, first + column].reshape(-1)[places] = np.float32(scales[1]) * own_turn[:, axis]
                _write_right_side(
                    *(graph.first, graph.second, bend.before, bend.after),
                    *(chords.chord_mm, pulls.at_first, pulls.at_second, bend.per_squared, bend.factor),
                    *(*weights, distance_error, normal_error),
                    *scales,
                    *(turned, own, right[:, column], turned_squared),
                )
            give_back_free_memory()
            jobs.append(pool.submit(solve_set, first, right))
            del right
            if threads == 1:
                jobs[-1].result()
    for job in jobs:
        job.result()
    return errors, slides, own_turns, turned_squared / DRAWS


def _drawn(
    noise: NoiseDraw, rng: np.random.Generator, *, threads: int
) -> Iterator[tuple[SomePixels, SomeVectors, SomeVectors, SomeVectors]]:
    """Yield the draws one after the other; with several threads, the next is made while one is used."""
    if threads == 1:
        yield from (noise(rng) for _ in range(DRAWS))
        return
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(noise, rng)
        for _ in range(DRAWS - 1):
            drawn, coming = coming.result(), pool.submit(noise, rng)
            yield drawn
        yield coming.result()


@compiled
def _write_right_side(
    first: np.ndarray,
    second: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    chord: np.ndarray,
    at_first: np.ndarray,
    at_second: np.ndarray,
    per_squared: np.ndarray,
    factor: np.ndarray,
    chord_weight: np.ndarray,
    own_weight: np.ndarray,
    shift: np.ndarray,
    tilt: np.ndarray,
    shift_scale: float,
    tilt_scale: float,
    turned: np.ndarray,
    own: np.ndarray,
    right: np.ndarray,
    turned_squared: np.ndarray,
) -> None:
    """Write the right side of one error of every distance and normal, and add the squares of the latter.

    ``turned`` is room for two numbers a pair, ``own`` for one a pixel.
    """
    for pixel in range(len(own)):
        # Where nothing was measured, nothing was drawn.
        own[pixel] = own_weight[pixel] * shift_scale * shift[pixel] if own_weight[pixel] > 0 else 0.0
        for k in range(3):
            turned_squared[pixel] += (tilt_scale * tilt[pixel, k]) ** 2
    for pair in range(len(first)):
        one = other = 0.0
        for k in range(3):
            one += tilt[first[pair], k] * chord[pair, k]
            other += tilt[second[pair], k] * chord[pair, k]
        turned[0, pair] = 0.5 * tilt_scale * (one + other)
        turned[1, pair] = tilt_scale * (other - one) * per_squared[pair]
    for pair in range(len(first)):
        height = factor[pair] * (turned[1, after[pair]] - turned[1, before[pair]]) if factor[pair] != 0 else 0.0
        pull = chord_weight[pair] * (turned[0, pair] - height)
        own[first[pair]] -= at_first[pair] * pull
        own[second[pair]] -= at_second[pair] * pull
    for pixel in range(len(own)):
        right[pixel] = own[pixel]


def independent_noise(rays: Rays) -> NoiseDraw:
    """Return draws of distances and normals that know nothing of each other, from the standard deviations alone."""
    count = len(rays.precision)
    sd = np.sqrt(np.divide(1.0, rays.precision, out=np.zeros(count), where=rays.precision > 0))

    def draw(rng: np.random.Generator) -> tuple[SomePixels, SomeVectors, SomeVectors, SomeVectors]:
        tilt = np.sqrt(rays.tilt_variance)[:, None] * rng.standard_normal(rays.normal.shape)
        tilt -= (tilt * rays.normal).sum(axis=1, keepdims=True) * rays.normal
        distance_error = (sd * rng.standard_normal(count)).astype(np.float32)
        turn = tilt.astype(np.float32)
        return distance_error, turn, np.zeros((count, 3), np.float32), turn

    return draw


def standard_deviation(
    errors: Float[np.ndarray, "draws rows cols"], mask: Mask, *, window_px: int = DRAW_WINDOW_PX
) -> Float64[np.ndarray, "rows cols"]:
    """Return the root mean square of the draws, averaged over a window, on which an uncertainty is smooth."""
    squares = np.einsum("drc,drc->rc", errors, errors, dtype=np.float64)
    total = _window_sum(np.where(mask, np.nan_to_num(squares), 0.0), window_px)
    count = _window_sum(mask.astype(np.float64), window_px)
    return np.where(mask, np.sqrt(total / np.maximum(count, 1.0) / len(errors)), np.nan)


def _window_sum(values: ScalarMap, window_px: int) -> ScalarMap:
    """Sum over a window, term by term: a running sum would leave large values' rounding on small ones."""
    box = np.ones(window_px)
    return np.asarray(cv2.sepFilter2D(values, cv2.CV_64F, box, box, borderType=cv2.BORDER_CONSTANT), np.float64)
