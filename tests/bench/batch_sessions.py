"""A batch with broken sessions and a killed worker, on processes and on a Dask cluster: ``python -m tests.bench.batch_sessions``.

It simulates small sessions, breaks two of them, runs `recon batch` on this machine and then on a cluster of two workers of this
machine, kills the worker of one session in each, and compares what came of it. Prints a table and JSON; the status is 1 where a
good session is not done, a broken one is not named, or the results differ.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import contextmanager
from pathlib import Path

from recon.batch.session_status import SessionStatus, load_status
from tests.batch_example import EQUAL_FILES, hashes, killed_worker, make_sessions
from tests.dask_cluster import local_cluster

BROKEN = ("broken-manifest", "lost-photo")


def run(sessions: Path, out: Path, victim: str, *options: str) -> dict[str, object]:
    """Run one batch, kill the worker of ``victim`` once, and say how it went."""
    command = [sys.executable, "-c", "from recon.cli import main; main()", "batch", f"{sessions}/*", "--out", str(out)]
    start_s = time.perf_counter()
    with killed_worker(out / victim):
        done = subprocess.run([*command, *options], capture_output=True, text=True, check=False)
    took_s = time.perf_counter() - start_s
    statuses = {folder.name: load_status(out / folder.name) for folder in sorted(sessions.iterdir())}
    return {
        "took_s": round(took_s, 1),
        "exit_status": done.returncode,
        "sentence": done.stderr.strip(),
        "states": {name: status.state if status else "none" for name, status in statuses.items()},
        "attempts": {
            name: _attempts(status) for name, status in statuses.items() if status and len(status.attempts) > 1
        },
        "faults": {name: status.fault for name, status in statuses.items() if status and status.fault},
    }


def _attempts(status: SessionStatus) -> list[str]:
    return [f"{one.end}{f' ({one.cause})' if one.cause else ''}" for one in status.attempts]


def differing(first: Path, second: Path, names: list[str]) -> dict[str, list[str]]:
    """Return the files of each session that are not the same bytes in both."""
    found = {name: (hashes(first / name), hashes(second / name)) for name in names}
    return {name: [file for file in EQUAL_FILES if a[file] != b[file]] for name, (a, b) in found.items() if a != b}


def table(names: list[str], runs: Mapping[str, dict[str, object]]) -> str:
    """Return one line a session: its state and its attempts in each run."""
    lines = [f"{'session':24}" + "".join(f"{run:34}" for run in runs)]
    for name in names:
        cells = []
        for found in runs.values():
            states, attempts = found["states"], found["attempts"]
            assert isinstance(states, dict)
            assert isinstance(attempts, dict)
            cells.append(f"{states[name]} {'after ' + attempts[name][0] if name in attempts else ''}"[:33])
        lines.append(f"{name:24}" + "".join(f"{cell:34}" for cell in cells))
    return "\n".join(lines)


@contextmanager
def folder_for(given: Path | None):
    """Give the folder that was asked for, or one that is removed at the end."""
    if given is not None:
        given.mkdir(parents=True, exist_ok=True)
        yield given
        return
    with tempfile.TemporaryDirectory() as place:
        yield Path(place)


def main() -> int:
    """Run both batches and compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=20, help="sessions in all, two of which are broken")
    parser.add_argument("--size", type=int, default=64, help="columns of the photos")
    parser.add_argument("--folder", type=Path, help="where to leave sessions and results")
    asked = parser.parse_args()
    with folder_for(asked.folder) as place:
        sessions, logs = place / "sessions", place / "logs"
        logs.mkdir()
        good = make_sessions(
            sessions, good=asked.sessions - len(BROKEN), size=asked.size, display_columns=2 * asked.size
        )
        victim = good[len(good) // 2]
        runs = {"this machine": run(sessions, place / "here", victim, "--jobs", "2", "--force")}
        with local_cluster(logs, workers=2) as address:
            runs["Dask"] = run(sessions, place / "dask", victim, "--scheduler", address, "--force")
        apart = differing(place / "here", place / "dask", good)
    expected = dict.fromkeys(good, "done") | dict.fromkeys(BROKEN, "failed")
    sound = not apart and all(one["states"] == expected and victim in one["attempts"] for one in runs.values())  # type: ignore[operator]
    print(table([*good, *BROKEN], runs))
    print(
        json.dumps(
            {
                "sessions": asked.sessions,
                "size_px": asked.size,
                "runs": runs,
                "compared": EQUAL_FILES,
                "differing": apart,
                "sound": sound,
            },
            indent=2,
        )
    )
    return 0 if sound else 1


if __name__ == "__main__":
    sys.exit(main())
