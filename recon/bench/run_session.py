"""The photos of a whole session of the benchmark, written once and kept for a later run with the same wishes."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8

from recon.bench.bench_scene import (
    DARK_COUNTS,
    NOISE_OFFSETS_PX,
    READ_NOISE_COUNTS,
    SHOT_NOISE_COUNTS,
    STRIPE_COUNTS,
    STRIPE_WIDTH_PX,
)
from recon.bench.bench_session import encoded, quality_of
from recon.bench.run_scene import RunScene, run_scene
from recon.errors import ReconError
from recon.sessions.session import SessionWriter

KEPT_NAME = "bench-run.json"
SESSION_NAME = "session"
BAND_ROWS = 128


@dataclass(frozen=True, slots=True)
class RunSession:
    """A session on disk, the JPEG quality of its photos, their mean size and how many there are."""

    folder: Path
    quality: int
    file_mb: float
    photos: int


def kept_or_written(
    folder: Path,
    *,
    columns: int,
    photos: int,
    object_megapixels: float,
    photo_bytes: float,
    seed: int,
    say: Callable[[str], None],
) -> RunSession:
    """Return the session that an earlier run wrote into the folder with the same wishes, or write it."""
    note = folder / KEPT_NAME
    wishes = {
        "columns": columns,
        "photos": photos,
        "object_megapixels": object_megapixels,
        "photo_bytes": photo_bytes,
        "seed": seed,
    }
    if note.is_file():
        kept = json.loads(note.read_text(encoding="utf-8"))
        if {name: kept[name] for name in wishes} != wishes:
            raise ReconError(f"{folder}: holds photos of another benchmark; choose another folder, or remove this one")
        return RunSession(folder / SESSION_NAME, kept["quality"], kept["file_mb"], kept["total"])
    scene = run_scene(columns=columns, photos=photos, object_megapixels=object_megapixels)
    made = _written(folder / SESSION_NAME, scene, photo_bytes=photo_bytes, seed=seed, say=say)
    found = {"quality": made.quality, "file_mb": made.file_mb, "total": made.photos}
    note.write_text(json.dumps({**wishes, **found}), encoding="utf-8")
    return made


def _written(folder: Path, scene: RunScene, *, photo_bytes: float, seed: int, say: Callable[[str], None]) -> RunSession:
    """Write four sets of two sweeps, each set with a photo of the dark display."""
    rng = np.random.default_rng(seed)
    shape = (scene.manifest.camera.rows, scene.manifest.camera.columns)
    dark = _dark_frame(shape, rng=rng)
    first = scene.manifest.sets[0]
    middle = first.sweep("x").pattern.count // 2
    quality = quality_of(
        _photo(dark, shape, scene, *_in_order(scene.place_px(first, "x")), middle, rng=rng), photo_bytes
    )
    sizes: list[int] = []
    with SessionWriter.create(folder, scene.manifest) as writer:
        for one in scene.manifest.sets:
            writer.save_photo(encoded(_cut(dark, shape, rng=rng), quality), set_name=one.name, sweep="black")
            for sweep in one.sweeps:
                say(f"writing {sweep.pattern.count} photos of {one.name}/{sweep.axis}")
                in_order, order = _in_order(scene.place_px(one, sweep.axis))
                for index in range(sweep.pattern.count):
                    data = encoded(_photo(dark, shape, scene, in_order, order, index, rng=rng), quality)
                    writer.save_photo(data, set_name=one.name, sweep=sweep.axis, index=index)
                    sizes.append(len(data))
    return RunSession(folder, quality, float(np.mean(sizes)) / 1e6, len(sizes))


def _in_order(place_px: Float32[np.ndarray, " pixels"]) -> tuple[np.ndarray, np.ndarray]:
    """Return the places in ascending order, and which pixels they belong to."""
    order = np.argsort(place_px)
    return place_px[order], order


def _dark_frame(shape: tuple[int, int], *, rng: np.random.Generator) -> UInt8[np.ndarray, "rows cols 3"]:
    """Return a colour photo of the dark display, larger than a photo: each is cut from another place of it."""
    rows, cols = (size + NOISE_OFFSETS_PX for size in shape)
    frame = np.empty((rows, cols, 3), dtype=np.uint8)
    for low in range(0, rows, BAND_ROWS):
        band = frame[low : low + BAND_ROWS]
        noisy = DARK_COUNTS + READ_NOISE_COUNTS * rng.standard_normal(band.shape, dtype=np.float32)
        band[:] = np.clip(np.rint(noisy), 0, 255)
    return frame


def _cut(
    dark: UInt8[np.ndarray, "rows cols 3"], shape: tuple[int, int], *, rng: np.random.Generator
) -> UInt8[np.ndarray, "some_rows some_cols 3"]:
    row, col = (int(rng.integers(0, NOISE_OFFSETS_PX)) for _ in range(2))
    return dark[row : row + shape[0], col : col + shape[1]].copy()


def _photo(
    dark: UInt8[np.ndarray, "rows cols 3"],
    shape: tuple[int, int],
    scene: RunScene,
    in_order: Float32[np.ndarray, " pixels"],
    order: np.ndarray,
    index: int,
    *,
    rng: np.random.Generator,
) -> UInt8[np.ndarray, "some_rows some_cols 3"]:
    """Return the photo of stripe ``index``: ``in_order`` are the places in device pixels of the object's pixels in ``order``."""
    photo = _cut(dark, shape, rng=rng)
    half = np.float32(STRIPE_WIDTH_PX / 2)
    first, last = np.searchsorted(in_order, [np.float32(index) - half, np.float32(index) + half])
    distance = in_order[first:last] - np.float32(index)
    counts = DARK_COUNTS + STRIPE_COUNTS / 2 * (1 + np.cos(2 * np.pi / STRIPE_WIDTH_PX * distance))
    sd = np.sqrt(READ_NOISE_COUNTS**2 + SHOT_NOISE_COUNTS * (counts - DARK_COUNTS)).astype(np.float32)
    noisy = counts[:, None] + sd[:, None] * rng.standard_normal((len(counts), 3), dtype=np.float32)
    photo.reshape(-1, 3)[scene.pixels[order[first:last]]] = np.clip(np.rint(noisy), 0, 255)
    return photo
