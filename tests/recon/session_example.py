"""A tiny session written by hand: four sets, short sweeps, 16 by 12 photos. Enough to be refused for the right reason."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import simplejpeg

ROWS, COLS, PLACES = 12, 16, 5
POSE = {"x_axis": [1.0, 0.0, 0.0], "y_axis": [0.0, 1.0, 0.0]}


def manifest() -> dict[str, Any]:
    pattern = {"profile": "hard", "width_px": 1.0, "first_px": 0.0, "step_px": 1.0, "count": PLACES}
    sweeps = [{"axis": axis, "pattern": pattern} for axis in ("x", "y")]
    return {
        "schema_version": 1,
        "name": "tiny",
        "created": "2018-06-01T12:00:00Z",
        "method": "liquid",
        "object": {"name": "glass"},
        "liquid": {"name": "water", "n": 1.333},
        "display": {"columns": PLACES, "rows": PLACES, "pitch_mm": 1.0},
        "display_poses": [{"centre_mm": [0.0, 0.0, z], **POSE} for z in (10.0, 20.0)],
        "camera": {"columns": COLS, "rows": ROWS},
        "sets": [
            {"position": position, "condition": condition, "sweeps": sweeps}
            for condition in ("air", "liquid")
            for position in (0, 1)
        ],
    }


def write_session(folder: Path, *, fields: dict[str, Any] | None = None, photos: int = PLACES) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    data = fields or manifest()
    (folder / "manifest.json").write_text(json.dumps(data))
    rng = np.random.default_rng(0)
    lines = []
    for one in data["sets"]:
        name = f"pos{one['position']}_{one['condition']}"
        for axis in ("x", "y"):
            for index in range(photos):
                counts = rng.integers(0, 5, (ROWS, COLS, 1), dtype=np.uint8)
                counts[:, (3 * index) % COLS] = 200
                file = f"photos/{name}/{axis}/{index:04d}.jpg"
                path = folder / file
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(simplejpeg.encode_jpeg(counts, quality=95, colorspace="GRAY"))
                lines.append({"event": "photo", "set": name, "sweep": axis, "index": index, "file": file})
    (folder / "journal.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return folder
