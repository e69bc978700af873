"""What a display that slipped between dry and wet costs, and what photos of a board in the session bring back, against truth.

::

    python -m tests.bench.display_slip [--columns 480] [--slip-mm 0.3] [--glass-mm 0.7] [--out slip.json]

The scene is the middle of ``lab``: a glass hemisphere before a tablet that leans, a lens that distorts. The display slips in its
plane at position 1 in the liquid set only. The poses of the manifest are the simulator's own, so that what is not corrected is
the slip alone.
"""

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from recon.calibration.board_stage import BoardStage, board_stage
from recon.evaluation.truth import compare_with_truth, load_truth
from recon.run import decode_session
from recon.running.outcome import reconstruct
from recon.running.settings import Settings
from recon.sessions.session import Session, open_session
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.rehearsing.simulate import simulate_session
from sim_backend.disturbance import Disturbance
from sim_backend.scene import Scene, SceneGlass, load_scene

OPTIONS = SceneOptions(display_columns=1024, width_px=24, step_px=8, board=True)
# Of the lab's 720 × 480 pixels, those that see the tablet.
MIDDLE = {"columns": 480, "rows": 360, "centre_x_px": 242.1, "centre_y_px": 177.8}
DIRECTION = np.array([0.8, 0.6])
WAYS = {
    "not corrected": (False, False),
    "photos of the board": (True, False),
    "gaps of the light paths": (False, True),
    "both": (True, True),
}
Row = dict[str, float | str]


def lab(columns: int, glass_mm: float) -> Scene:
    """Return the middle of the lab with a hemisphere, its photos so wide, with cover glass of index 1.51 if any."""
    scene = open_scene("lab", OPTIONS).model_copy(update={"specimen": load_scene("hemisphere").specimen})
    camera = scene.camera.model_copy(update=MIDDLE)
    glass = SceneGlass(thickness_mm=glass_mm, n=1.51) if glass_mm else None
    panel = scene.display.model_copy(update={"cover_glass": glass})
    return scene.model_copy(update={"camera": camera, "display": panel}).resized(camera_columns=columns)


def rows_of(session: Session, *, ways: tuple[str, ...], title: str) -> Iterator[Row]:
    """Reconstruct one session in several ways and compare each with truth."""
    sweeps = decode_session(session, Settings())
    measured = board_stage(session, sweeps, calibration=None, object_mask=None, wanted=True)
    truth = load_truth(session.folder)
    for way in ways:
        board, registration = WAYS[way]
        stage = measured if board else BoardStage()
        outcome = reconstruct(
            stage.corrected_session(session),
            sweeps,
            Settings(registration=registration),
            known=stage.slip_covariance(),
        )
        found = compare_with_truth(outcome.maps, truth)
        yield {
            "display": title,
            "corrected by": way,
            "complete": found.complete,
            "point_mean_mm": found.point_mm.mean,
            "normal_mean_deg": float(np.degrees(found.normal_rad.mean)),
            "says": " / ".join(stage.poses.sentences()) if stage.poses else "",
        }


def main(
    columns: Annotated[int, typer.Option(help="Width of the photos.")] = 480,
    slip_mm: Annotated[float, typer.Option(help="How far the display slips.")] = 0.3,
    glass_mm: Annotated[float, typer.Option(help="Cover glass over the pixels; 0 for none.")] = 0.0,
    out: Annotated[Path | None, typer.Option(help="File for the table's numbers.")] = None,
) -> None:
    """Print the table, and write its numbers."""
    scene = lab(columns, glass_mm)
    config = config_of_scene(scene, OPTIONS)
    across_mm, down_mm = (float(part) for part in slip_mm * DIRECTION)
    slipped = {"pos1_liquid": Disturbance(display_shift_mm=(across_mm, down_mm))}
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for title, disturbances, ways in (
            ("undisturbed", {}, ("not corrected", "photos of the board", "both")),
            (f"slipped {slip_mm:g} mm", slipped, tuple(WAYS)),
        ):
            place = Path(folder, title.replace(" ", "-"))
            quiet = Console(quiet=True)
            simulate_session(scene, config, place, workers=2, console=quiet, disturbances=disturbances)
            for row in rows_of(open_session(place), ways=ways, title=title):
                rows.append(row)
                print(
                    f"| {row['display']} | {row['corrected by']} | {row['complete']:.1%} | {row['point_mean_mm']:.4f} mm | "
                    f"{row['normal_mean_deg']:.3f}° | {row['says']} |",
                    flush=True,
                )
    if out is not None:
        out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    typer.run(main)
