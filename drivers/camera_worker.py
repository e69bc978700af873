"""The process that libgphoto2 lives in: ``python -m drivers.camera_worker FD``.

A wedged C call cannot be interrupted from Python, and several calls keep the interpreter's lock; only the end of a process ends
them. So nothing but this process touches the camera, and the driver may end it at any time.

Over a pipe it answers one question after the other. A question is ``(number, operation, arguments, limit_s)``; its answer is the
number and ``("done", value)``, ``("gphoto2", code, text)``, ``("late", sentence)`` or ``("refused", sentence)``.
"""

import contextlib
import signal
import sys
from multiprocessing.connection import Connection
from typing import Any

from drivers.camera_settings import RefusedError
from drivers.open_camera import LateError, OpenCamera

# A question that takes this much longer than its limit is never answered: then the process ends itself, so that it
# does not hold the camera when the driver that should have ended it is gone as well.
ORPHAN_GRACE_S = 60.0
OPERATIONS = frozenset(
    {
        "open",
        "reset_port",
        "close",
        "settings",
        "apply",
        "choices",
        "expose",
        "release",
        "fetch",
        "collect",
        "spend",
        "drain",
        "preview",
    }
)


def answer(camera: OpenCamera, operation: str, arguments: dict[str, Any], limit_s: float) -> tuple[Any, ...]:
    """Carry out one operation and return what goes over the pipe."""
    if operation not in OPERATIONS:
        return "refused", f"the operation {operation!r} does not exist"
    camera.begin(limit_s)
    try:
        return "done", getattr(camera, operation)(**arguments)
    except LateError as error:
        return "late", str(error)
    except RefusedError as error:
        return "refused", str(error)
    except camera.gp.GPhoto2Error as error:
        return "gphoto2", error.code, error.string


def main() -> None:
    """Answer questions until the driver is gone."""
    pipe = Connection(int(sys.argv[1]))
    camera = OpenCamera()
    with contextlib.suppress(EOFError, OSError):
        while True:
            number, operation, arguments, limit_s = pipe.recv()
            signal.setitimer(signal.ITIMER_REAL, limit_s + ORPHAN_GRACE_S)  # its signal ends the process, even in C
            pipe.send((number, *answer(camera, operation, arguments, limit_s)))
            signal.setitimer(signal.ITIMER_REAL, 0)


if __name__ == "__main__":
    main()
