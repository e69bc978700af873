"""Sessions of the benchmark: the same photos as JPEG of several sizes, each size a folder that ``recon`` opens like any other."""

import json
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import simplejpeg

from recon.bench.bench_scene import ASPECT, BenchScene, bench_scene, photo
from recon.errors import ReconError
from recon.sessions.journal import now_text
from recon.sessions.manifest import (
    CameraBody,
    CaptureSet,
    DisplayPanel,
    Manifest,
    Pose,
    Provenance,
    ScannedObject,
    Sweep,
)
from recon.sessions.session import SessionWriter

SET_NAME = "pos0_with"
# Cameras of the paper's time halve the colours along rows alone.
COLOUR_SUBSAMPLING = "422"
QUALITIES = (1, 100)
KEPT_NAME = "bench.json"


@dataclass(frozen=True, slots=True)
class BenchSession:
    """A session on disk, the JPEG quality of its photos and their mean size."""

    folder: Path
    photos: int
    quality: int
    file_mb: float


def kept_or_written(
    folder: Path, *, columns: int, photos: int, photo_bytes: tuple[float, ...], seed: int
) -> tuple[BenchSession, ...]:
    """Return the sessions that an earlier run wrote into the folder with the same wishes, or write them."""
    note = folder / KEPT_NAME
    wishes = {"columns": columns, "photos": photos, "photo_bytes": list(photo_bytes), "seed": seed}
    if not note.is_file():
        made = write_bench_sessions(folder, columns=columns, photos=photos, photo_bytes=photo_bytes, seed=seed)
        sizes = [[one.quality, one.file_mb] for one in made]
        note.write_text(json.dumps({**wishes, "quality_and_mb": sizes}), encoding="utf-8")
        return made
    kept = json.loads(note.read_text(encoding="utf-8"))
    if {name: kept[name] for name in wishes} != wishes:
        raise ReconError(f"{folder}: holds photos of another benchmark; choose another folder, or remove this one")
    return tuple(
        BenchSession(folder / str(number), photos, quality, file_mb)
        for number, (quality, file_mb) in enumerate(kept["quality_and_mb"])
    )


def write_bench_sessions(
    folder: Path, *, columns: int, photos: int, photo_bytes: tuple[float, ...], seed: int
) -> tuple[BenchSession, ...]:
    """Write one sweep along x, and a photo of the dark display, once for each wanted size of a photo in bytes."""
    scene = bench_scene(columns=columns, photos=photos, seed=seed)
    rng = np.random.default_rng(seed + 1)
    # Midway between the rim of the ellipse and its middle, where most is lit and a photo is largest.
    typical = photo(scene, photos // 4, rng=rng)
    qualities = [quality_of(typical, wanted) for wanted in photo_bytes]
    sizes: list[list[int]] = [[] for _ in qualities]
    with ExitStack() as stack:
        writers = [
            stack.enter_context(SessionWriter.create(folder / str(number), manifest_of(scene)))
            for number in range(len(qualities))
        ]
        for index in (None, *range(photos)):
            colours = photo(scene, index, rng=rng)
            for writer, quality, own_sizes in zip(writers, qualities, sizes, strict=True):
                data = encoded(colours, quality)
                sweep, number = ("black", 0) if index is None else ("x", index)
                writer.save_photo(data, set_name=SET_NAME, sweep=sweep, index=number)
                own_sizes.append(len(data))
    return tuple(
        BenchSession(writer.folder, photos, quality, float(np.mean(own_sizes)) / 1e6)
        for writer, quality, own_sizes in zip(writers, qualities, sizes, strict=True)
    )


def encoded(colours: np.ndarray, quality: int) -> bytes:
    """Return a colour photo [rows, cols, 3] as JPEG."""
    data: bytes = simplejpeg.encode_jpeg(
        colours, quality=quality, colorspace="RGB", colorsubsampling=COLOUR_SUBSAMPLING
    )
    return data


def quality_of(colours: np.ndarray, wanted_bytes: float) -> int:
    """Return the highest JPEG quality whose file is no larger than wanted, or the lowest there is."""
    low, high = QUALITIES
    while low < high:
        middle = (low + high + 1) // 2
        if len(encoded(colours, middle)) <= wanted_bytes:
            low = middle
        else:
            high = middle - 1
    return low


def manifest_of(scene: BenchScene) -> Manifest:
    """Return the manifest of a session of which only the first sweep is photographed."""
    rows, columns = scene.lit.shape
    sweeps = (Sweep(axis="x", pattern=scene.pattern), Sweep(axis="y", pattern=scene.pattern))
    first, second = (Pose(centre_mm=(0, 0, z), x_axis=(1, 0, 0), y_axis=(0, 1, 0)) for z in (100.0, 200.0))
    count = scene.pattern.count
    return Manifest(
        schema_version=1,
        name="benchmark",
        created=now_text(),
        method="thin",
        object=ScannedObject(name="lens", n=1.5),
        display=DisplayPanel(columns=count, rows=count, pitch_mm=0.25, continuous=True),
        display_poses=(first, second),
        camera=CameraBody(columns=columns, rows=rows),
        sets=(
            CaptureSet(position=0, condition="with", sweeps=sweeps),
            CaptureSet(position=1, condition="with", sweeps=sweeps),
        ),
        provenance=Provenance(note=f"synthesised by recon bench; rows are {ASPECT:.4g} of columns"),
    )
