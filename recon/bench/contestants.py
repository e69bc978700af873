"""What is timed: our correspondence stage, decoding alone, and the scripts that a person would write first.

Each takes a session of the benchmark and returns a map [rows, cols] of the brightest photo's number, or ``None`` where it makes
none. The naive ones are written out as one meets them; they know nothing of noise, so that dark pixels get a number as well.
"""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import simplejpeg

from recon.method import Method
from recon.sessions.photos import read_grey
from recon.sessions.session import Session
from recon.status import PixelStatus
from recon.sweeps.correspondence import decode_sweep

LOOP = "simplejpeg loop"
DECODING = "decoding alone"
PAPER = "sweep, paper"
FULL = "sweep, full"
RUNNING = "running argmax"
STACK = "stack argmax"

Contestant = Callable[[Session], np.ndarray | None]


def simplejpeg_loop(session: Session) -> None:
    """Decode every photo with simplejpeg, and nothing else."""
    for path in sweep_files(session):
        simplejpeg.decode_jpeg(path.read_bytes(), "GRAY")


def decoding_alone(session: Session) -> None:
    """Decode every photo as our sweep does, into one buffer that is used again."""
    camera = session.manifest.camera
    buffer = None
    for path in sweep_files(session):
        buffer = read_grey(path, rows=camera.rows, cols=camera.columns, buffer=buffer)


def paper_sweep(session: Session) -> np.ndarray:
    """Run the correspondence stage with the paper's parabola."""
    return _sweep(session, "paper")


def full_sweep(session: Session) -> np.ndarray:
    """Run the correspondence stage with the maximum-likelihood fit."""
    return _sweep(session, "full")


def _sweep(session: Session, method: Method) -> np.ndarray:
    result = decode_sweep(session, session.manifest.sets[0], "x", method=method)
    return np.where(result.status == PixelStatus.OK, result.place_px, np.nan)


def running_argmax(session: Session) -> np.ndarray:
    """OpenCV and NumPy, photo by photo: decode in colour, make grey, write where it is brighter than all before."""
    best = number = None
    for index, path in enumerate(sweep_files(session)):
        grey = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2GRAY)
        if best is None or number is None:
            best, number = grey.copy(), np.zeros(grey.shape, dtype=np.int32)
        brighter = grey > best
        best[brighter] = grey[brighter]
        number[brighter] = index
    assert number is not None
    return number


def stack_argmax(session: Session) -> np.ndarray:
    """OpenCV and NumPy, all photos in memory: one stack [photos, rows, cols] and its argmax."""
    stack = np.stack([np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)) for path in sweep_files(session)])
    return np.argmax(stack, axis=0)


def sweep_files(session: Session) -> list[Path]:
    """Return the photos of the sweep in order."""
    capture_set = session.manifest.sets[0]
    return [session.photo_file(capture_set.name, "x", index) for index in session.photo_numbers(capture_set, "x")]


CONTESTANTS: dict[str, Contestant] = {
    LOOP: simplejpeg_loop,
    DECODING: decoding_alone,
    PAPER: paper_sweep,
    FULL: full_sweep,
    RUNNING: running_argmax,
    STACK: stack_argmax,
}
