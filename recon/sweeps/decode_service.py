"""A process of its own that decodes sweeps while a capture goes on: ``python -m recon.sweeps.decode_service SESSION``.

It reads one JSON object a line from standard input and answers each with one line: ``{"set": …, "axis": …}`` is answered by
the sweep's quality, whose places are kept in the session (``correspondence_store``); ``{"cross": true}`` by what the sweeps
of all four sets come to. What cannot be done is answered by ``{"error": sentence}``. It ends with its input.
"""

import json
import os
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np

from recon.errors import ReconError
from recon.media.stated_index import provisional
from recon.method import Limits, Method
from recon.reconstruct import cross_paths
from recon.sessions.manifest import Axis
from recon.sessions.session import open_session
from recon.status import PixelStatus
from recon.sweeps.correspondence import SweepResult
from recon.sweeps.correspondence_store import stored_or_decoded
from recon.sweeps.sweep_quality import sweep_quality

# The camera must never wait for this process.
NICENESS = 10
METHOD: Method = "full"


def answer(folder: Path, question: dict[str, Any]) -> dict[str, Any]:
    """Answer one question about the session in ``folder``."""
    try:
        if question.get("cross"):
            return _entry_points(folder)
        return _decoded(folder, question["set"], "x" if question["axis"] == "x" else "y")
    except ReconError as error:
        return {"error": str(error)}
    except MemoryError:
        return {"error": "not enough memory to decode a sweep while photographing; close other programs"}
    except Exception as error:  # whatever it is must reach the operator as a sentence, and the next sweep its turn
        return {"error": f"decoding failed ({type(error).__name__}: {error})"}


def _decoded(folder: Path, set_name: str, axis: Axis) -> dict[str, Any]:
    session = open_session(folder)
    capture_set = session.manifest.set_named(set_name)
    result = stored_or_decoded(session, capture_set, axis, method=METHOD)
    return {"quality": asdict(sweep_quality(result, set_name=set_name, axis=axis))}


def _entry_points(folder: Path) -> dict[str, Any]:
    """Cross the paths of all four sets: how many pixels become points, and how sure these are."""
    session = open_session(folder)
    manifest = session.manifest
    if manifest.method != "liquid":
        return {"error": "a thin object's paths cross nothing; run `recon run` for its surface"}
    sweeps: dict[tuple[str, str], SweepResult] = {
        (one.name, sweep.axis): stored_or_decoded(session, one, sweep.axis, method=METHOD)
        for one in manifest.sets
        for sweep in one.sweeps
    }
    _, crossing = cross_paths(sweeps, provisional(manifest), method=METHOD, limits=Limits())
    fine = crossing.status == PixelStatus.OK
    variance = np.trace(crossing.points.covariance[fine], axis1=1, axis2=2)
    return {
        "matched": len(crossing.status),
        "entry_points": int(fine.sum()),
        "sd_mm": float(np.sqrt(np.median(variance))) if fine.any() else None,
    }


def serve(folder: Path, questions: TextIO, answers: TextIO) -> None:
    """Answer every line of ``questions`` until there are no more."""
    for question in _lines(questions):
        answers.write(json.dumps({**question, **answer(folder, question)}) + "\n")
        answers.flush()


def _lines(questions: TextIO) -> Iterator[dict[str, Any]]:
    for line in questions:
        if line.strip():
            yield json.loads(line)


if __name__ == "__main__":
    os.nice(NICENESS)
    cv2.setNumThreads(1)
    serve(Path(sys.argv[1]), sys.stdin, sys.stdout)
