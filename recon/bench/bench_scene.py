"""What the photos of the benchmark show: a stripe seen through a smooth map of places, with a camera's noise."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from recon.sessions.manifest import StripePattern

# The camera of the paper: 3888 × 2592.
ASPECT = 2592 / 3888
STRIPE_WIDTH_PX = 4.0
# The sweep begins and ends beyond what is seen, as a sweep of the whole display does.
UNSEEN_PHOTOS = 3

DARK_COUNTS = 6.0
STRIPE_COUNTS = 170.0
READ_NOISE_COUNTS = 1.8
# Variance of a sample per count of light, in counts.
SHOT_NOISE_COUNTS = 0.08
# The noise is drawn once and laid under every photo and colour at another offset of up to so many pixels.
NOISE_OFFSETS_PX = 256


@dataclass(frozen=True, slots=True, eq=False)
class BenchScene:
    """Which stripe position each camera pixel sees, and which pixels see the display at all."""

    pattern: StripePattern
    place_px: Float32[np.ndarray, "rows cols"]
    lit: Bool[np.ndarray, "rows cols"]
    noise: Float32[np.ndarray, "noise_rows noise_cols"]


def bench_scene(*, columns: int, photos: int, seed: int) -> BenchScene:
    """Return a scene whose sweep of ``photos`` photos passes over an ellipse of π/4 of the frame; 16 photos or more."""
    rows = round(columns * ASPECT)
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j].astype(np.float32)
    square = x * x + y * y
    # A lens before the display: stronger towards the rim, and a little askew.
    share = 0.5 + x * (0.35 + 0.1 * square) + 0.03 * np.sin(3 * y)
    rng = np.random.default_rng(seed)
    pattern = StripePattern(profile="raised_cosine", width_px=STRIPE_WIDTH_PX, first_px=0.0, step_px=1.0, count=photos)
    return BenchScene(
        pattern=pattern,
        place_px=(UNSEEN_PHOTOS + share * (photos - 1 - 2 * UNSEEN_PHOTOS)).astype(np.float32),
        lit=square < 1,
        noise=rng.standard_normal((rows + NOISE_OFFSETS_PX, columns + NOISE_OFFSETS_PX), dtype=np.float32),
    )


def photo(scene: BenchScene, index: int | None, *, rng: np.random.Generator) -> UInt8[np.ndarray, "rows cols 3"]:
    """Return a colour photo of stripe number ``index``, or of the dark display for ``None``."""
    counts = np.full(scene.place_px.shape, np.float32(DARK_COUNTS))
    if index is not None:
        distance = scene.place_px - np.float32(scene.pattern.first_px + scene.pattern.step_px * index)
        near = scene.lit & (np.abs(distance) < STRIPE_WIDTH_PX / 2)
        counts[near] += STRIPE_COUNTS / 2 * (1 + np.cos(2 * np.pi / STRIPE_WIDTH_PX * distance[near]))
    sd = np.sqrt(READ_NOISE_COUNTS**2 + SHOT_NOISE_COUNTS * (counts - np.float32(DARK_COUNTS)))
    rows, cols = scene.lit.shape
    colours = np.empty((rows, cols, 3), dtype=np.uint8)
    for plane in range(3):
        row, col = (int(rng.integers(0, NOISE_OFFSETS_PX)) for _ in range(2))
        noisy = counts + sd * scene.noise[row : row + rows, col : col + cols]
        colours[:, :, plane] = np.clip(np.rint(noisy), 0, 255)
    return colours
