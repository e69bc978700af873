"""What a run makes again after a change, and how long it takes: ``python -m tests.bench.kept_stages`` prints a table and JSON.

The same session is run as it is, again without a change, with another threshold, with one photo taken again, and by force.
"""

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from recon.method import Limits
from recon.metrics import StageTime
from recon.run import run_session
from recon.running.settings import Settings
from recon.sessions.disk import Disk
from recon.sessions.session import SessionWriter, open_session
from rig.rehearsing.scene_config import SceneOptions, config_of_scene, open_scene
from rig.rehearsing.simulate import simulate_session


def said(stage: StageTime) -> str:
    """Write one stage as the command does."""
    return "kept" if stage.kept else f"{stage.wall_s:.2f} s" + (f" ({stage.detail})" if stage.detail else "")


def take_again(folder: Path) -> None:
    """Append one photo of the session to it once more, as a person does who doubts it; its bytes are not the same."""
    session = open_session(folder)
    one = session.manifest.sets[0]
    number = session.photo_numbers(one, "x")[3]
    data = session.photo_file(one.name, "x", number).read_bytes()
    with SessionWriter.reopen(folder, disk=Disk(durable=False)) as writer:
        comment = b"\xff\xfe\x00\x07again"  # a JPEG comment segment (ITU-T T.81, B.2.4.5) behind the start of image
        writer.save_photo(
            data[:2] + comment + data[2:],
            set_name=one.name,
            sweep="x",
            index=number,
            place_px=session.photos[one.name, "x", number].place_px,
        )


def main() -> None:
    """Run the session five times and say what each run kept."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=240, help="columns of the photos")
    size = parser.parse_args().size
    options = SceneOptions(camera_columns=size, display_columns=1536, width_px=24.0, step_px=4.0)
    scene = open_scene("hemisphere", options)
    rows = []
    with tempfile.TemporaryDirectory() as place:
        session, out = Path(place) / "session", Path(place) / "result"
        simulate_session(scene, config_of_scene(scene, options), session, workers=2, console=Console(quiet=True))
        usual, strict = Settings(), Settings(limits=Limits(gap_sigma=3.0))
        for name, settings in (
            ("first run", usual),
            ("nothing changed", usual),
            ("another threshold", strict),
            ("a photo taken again", strict),
            ("by force", replace(strict, force=True)),
        ):
            if name == "a photo taken again":
                take_again(session)
            start_s = time.perf_counter()
            metrics = run_session(session, out, settings)
            took_s = time.perf_counter() - start_s
            rows.append({"run": name, "took_s": round(took_s, 2), **{one.name: said(one) for one in metrics.stages}})
    for row in rows:
        print(f"{row['run']}: {row['took_s']} s in all")
        for stage, text in row.items():
            if stage not in ("run", "took_s"):
                print(f"    {stage}: {text}")
    print(json.dumps({"size_px": size, "runs": rows}, indent=2))


if __name__ == "__main__":
    main()
