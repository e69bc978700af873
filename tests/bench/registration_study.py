"""What registration does for a session whose display slipped, and what wrong assumptions cost: prints tables, writes JSON.

``python -m tests.bench.registration_study [--size 256] [--display-columns 2048] [--json FILE]``. The twin of the paper's
hemisphere over a tablet behind 1.5 mm of glass; its correspondences come straight from the simulator's optics, with 0.1 px of
noise.
"""

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from recon.evaluation.sphere import fit_sphere
from recon.evaluation.truth import compare_with_truth
from recon.running.outcome import Outcome, reconstruct
from recon.running.settings import Settings
from recon.sessions.session import Session
from sim_backend.scene import Scene, load_scene
from sim_backend.scene_parts import SceneGlass
from tests.traced_session import NOTHING_WRONG, Mishap, TracedSession, traced_session

NOISE_PX = 0.1
RADIUS_MM = 27.99
METHODS = {
    "paper": Settings(method="paper"),
    "full, --no-registration": Settings(registration=False),
    "full": Settings(),
}
# Slips of both displays in mm and rad, small, middling and large.
MISHAPS: Mapping[str, Mishap] = {
    "nothing wrong": NOTHING_WRONG,
    "position 1 slipped by 0.3 mm": Mishap({"pos1_liquid": (0.3, 0.0, 0.0)}),
    "slips of 0.2 and 0.1 mm": Mishap({"pos0_liquid": (0.2, 0.0, 0.001), "pos1_liquid": (0.0, -0.1, 0.0)}),
    "slips of 0.5 and 0.4 mm": Mishap({"pos0_liquid": (0.3, -0.4, 0.0), "pos1_liquid": (-0.4, 0.0, 0.002)}),
    "slips of 0.7 and 0.7 mm": Mishap({"pos0_liquid": (0.5, 0.5, -0.003), "pos1_liquid": (-0.5, 0.5, 0.003)}),
    "object moved aside by 0.3 mm": Mishap(object_shift_mm=(0.3, 0.0, 0.0)),
    "object rose by 0.3 mm": Mishap(object_shift_mm=(0.0, 0.0, -0.3)),
}


def twin(size: int, display_columns: int, name: str = "hemisphere") -> Scene:
    """Return a built-in scene at this size, its display behind 1.5 mm of glass."""
    scene = load_scene(name).resized(camera_columns=size, display_columns=display_columns)
    glass = SceneGlass(thickness_mm=1.5, n=1.52)
    return scene.model_copy(update={"display": scene.display.model_copy(update={"cover_glass": glass})})


def outcome_of(session: TracedSession, settings: Settings) -> Outcome:
    """Reconstruct a session that has no photos."""
    return reconstruct(Session(Path("no photos"), session.manifest, {}), session.sweeps, settings)


def judged(session: TracedSession, outcome: Outcome) -> dict[str, object]:
    """Return the errors of a reconstruction against the truth, and what it says of itself."""
    compared = compare_with_truth(outcome.maps, session.truth)
    record, index = outcome.registration, outcome.liquid_index
    return {
        "complete": compared.complete,
        "position_mean_mm": compared.point_mm.mean,
        "position_median_mm": compared.point_mm.median,
        "normal_mean_deg": float(np.degrees(compared.normal_rad.mean)),
        "normal_median_deg": float(np.degrees(compared.normal_rad.median)),
        "error_over_sd": compared.normalised_rms,
        "normalised_gap": outcome.gap_ratio,
        "applied": record.applied if record else None,
        "index": index.level_n if index else None,
        "index_sd": index.level_sd if index else None,
        "says": [one for one in outcome.warnings if "shifted" in one or "index" in one],
    }


def rows_of(scene: Scene, name: str, mishap: Mishap, *, radius_mm: float | None) -> list[dict[str, object]]:
    """Reconstruct one mishap by every method."""
    session = traced_session(scene, noise_px=NOISE_PX, mishap=mishap)
    rows = []
    for method, settings in METHODS.items():
        outcome = outcome_of(session, settings)
        row = {"case": name, "method": method, **judged(session, outcome)}
        if radius_mm is not None:
            valid = outcome.maps.valid()
            fit = fit_sphere(outcome.maps.point_mm[valid], outcome.maps.normal[valid], rng=np.random.default_rng(0))
            row["radius_off_percent"] = 100 * (fit.sphere.radius_mm / radius_mm - 1)
        rows.append(row)
    return rows


def main() -> None:
    """Run all cases and print them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--display-columns", type=int, default=2048)
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    scene = twin(chosen.size, chosen.display_columns)
    rows = []
    for name, mishap in MISHAPS.items():
        rows += rows_of(scene, name, mishap, radius_mm=RADIUS_MM)
        print(name, file=sys.stderr, flush=True)
    bottle = twin(chosen.size, chosen.display_columns, "bottle")
    rows += rows_of(bottle, "bottle, nothing wrong", NOTHING_WRONG, radius_mm=None)
    columns = [key for key in rows[0] if key not in ("says", "applied", "index", "index_sd")]
    table = Table(*columns)
    for row in rows:
        table.add_row(*(f"{row[key]:.4g}" if isinstance(row.get(key), float) else str(row.get(key)) for key in columns))
    Console(width=200).print(table)
    for row in rows:
        for sentence in row["says"]:  # type: ignore[attr-defined]  # a list of sentences
            print(f"{row['case']}, {row['method']}: {sentence}")
    if chosen.json is not None:
        chosen.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
