"""Time and peak memory of decoding one sweep, of three lengths and with each code: the memory must not grow with the length.

    python -m tests.bench.decode_memory [--size 1024]

Each sweep is decoded in a process of its own, on one thread, and its peak is compared with that of a process that only
imports the decoder. The photos are made here: the pattern's own levels over the whole field, photon noise, about 8 bits.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import simplejpeg

from recon.patterns.pattern_frames import pattern_frame
from recon.patterns.phase_shift import periods_for
from recon.sessions.manifest import Sweep

LENGTHS = (48, 96, 192)
STRIPE = {"profile": "raised_cosine", "width_px": 6.0, "first_px": 0.0, "step_px": 1.0}


def patterns() -> Iterator[tuple[str, int, dict[str, object]]]:
    """Yield name, device pixels and fields of each pattern."""
    for places in LENGTHS:
        yield "stripe", places, {**STRIPE, "count": places}
    for places in (LENGTHS[-1], 8 * LENGTHS[-1]):
        yield "gray_line", places, {**STRIPE, "kind": "gray_line", "period_px": 16.0, "places": places}
    for places in (LENGTHS[-1], 8 * LENGTHS[-1]):
        periods = periods_for(float(places), finest_px=16.0, frequencies=3)
        yield (
            "phase_shift",
            places,
            {"kind": "phase_shift", "periods_px": periods, "steps": 8, "first_px": 0.0, "last_px": places - 1.0},
        )


POSE = {"x_axis": [1.0, 0.0, 0.0], "y_axis": [0.0, 1.0, 0.0]}


def write_session(folder: Path, pattern: dict[str, object], *, size: int, places: int) -> None:
    """Write a session whose first sweep is real and whose other sweeps are links to it."""
    sweeps = [{"axis": axis, "pattern": pattern} for axis in ("x", "y")]
    names = [(p, c) for c in ("air", "liquid") for p in (0, 1)]
    manifest = {
        "schema_version": 1,
        "name": "bench",
        "created": "",
        "method": "liquid",
        "object": {"name": "none"},
        "liquid": {"n": 1.333},
        "display": {"columns": places, "rows": places, "pitch_mm": 1.0},
        "display_poses": [{"centre_mm": [0, 0, z], **POSE} for z in (10.0, 20.0)],
        "camera": {"columns": size, "rows": size},
        "sets": [{"position": p, "condition": c, "sweeps": sweeps} for p, c in names],
    }
    folder.mkdir(parents=True)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    rng = np.random.default_rng(0)
    seen = np.linspace(2, places - 3, size)
    lines = []
    shown = Sweep.model_validate(sweeps[0]).pattern
    for index in range(shown.count):
        levels = pattern_frame(shown, "x", index, device_px=places).levels
        signal = 4 + 200 * np.interp(seen, np.arange(places), levels / 255)
        counts = rng.normal(signal, np.sqrt(0.5 + 0.02 * signal), (size, size))
        file = f"{index:04d}.jpg"
        grey = np.clip(np.rint(counts), 0, 255).astype(np.uint8)[:, :, None]
        (folder / file).write_bytes(simplejpeg.encode_jpeg(grey, quality=92, colorspace="GRAY"))
        lines.append(json.dumps({"event": "photo", "set": "pos0_air", "sweep": "x", "index": index, "file": file}))
    (folder / "journal.jsonl").write_text("\n".join(lines) + "\n")


def decode(folder: Path, method: str) -> None:
    """Decode the first sweep and print what it took."""
    from recon.sessions.session import open_session
    from recon.stage_timer import peak_memory_mb
    from recon.sweeps.decode_pattern import decode_pattern

    session = open_session(folder)
    before = peak_memory_mb()
    start = time.perf_counter()
    decode_pattern(session, session.manifest.sets[0], "x", method="paper" if method == "paper" else "full")
    wall = time.perf_counter() - start
    print(json.dumps({"wall_s": wall, "peak_mb": peak_memory_mb(), "of_decoding_mb": peak_memory_mb() - before}))


def main() -> None:
    """Print one line a method and length."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--decode", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--method", choices=("paper", "full"))
    arguments = parser.parse_args()
    if arguments.decode:
        decode(arguments.decode, arguments.method)
        return
    print(f"decoding one sweep of {arguments.size} x {arguments.size} photos on one thread")
    with tempfile.TemporaryDirectory() as scratch:
        for number, (name, places, pattern) in enumerate(patterns()):
            folder = Path(scratch) / str(number)
            write_session(folder, pattern, size=arguments.size, places=places)
            photos = Sweep.model_validate({"axis": "x", "pattern": pattern}).pattern.count
            for method in ("paper", "full"):
                command = [
                    sys.executable,
                    "-m",
                    "tests.bench.decode_memory",
                    "--decode",
                    str(folder),
                    "--method",
                    method,
                ]
                done = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
                print(
                    f"{name:11} {method:5} {photos:4} photos of {places} places: {done['wall_s']:6.2f} s, "
                    f"{photos / done['wall_s']:6.1f} photos/s, "
                    f"peak {done['peak_mb']:.0f} MB, of which decoding {done['of_decoding_mb']:.0f} MB"
                )


if __name__ == "__main__":
    main()
