"""An emulated camera in a process of its own, and the owner's side of it.

Two pipes join the processes, each a plain exchange of question and answer. On one the camera asks its owner for a photo when
its shutter closes: the world, its clock and its optics stay with the owner. On the other the owner sets faults, asks how
many photos were taken, and ends the camera.
"""

import argparse
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Literal, get_args

from drivers.errors import DeviceNotFoundError
from sim_backend.ptpip.body import Body
from sim_backend.ptpip.canon_eos import CanonEos40D
from sim_backend.ptpip.generic import GenericBody
from sim_backend.ptpip.responder import Responder
from sim_backend.ptpip.sources import Photographs, as_exposing

Model = Literal["generic", "canon-eos-40d"]
MODELS: tuple[str, ...] = get_args(Model)
BODIES: dict[str, type[Body]] = {"generic": GenericBody, "canon-eos-40d": CanonEos40D}
START_TIMEOUT_S = 30.0
END_TIMEOUT_S = 5.0


class EmulatedCamera:
    """The owner's handle on an emulated camera: its port, its faults, its count of photos."""

    def __init__(self, control: Connection, port: int) -> None:
        self._control = control
        self._lock = threading.Lock()
        self.port = port

    @property
    def address(self) -> str:
        """The camera's address as libgphoto2 writes it: both connections go to one port."""
        return f"ptpip:127.0.0.1:{self.port}:{self.port}"

    def set_faults(self, **changes: int) -> None:
        """Set faults by their names in :class:`sim_backend.ptpip.faults.Faults`."""
        self._ask("faults", changes)

    def pull_cable(self) -> None:
        """Break every connection now."""
        self._ask("break", {})

    def replace(self) -> None:
        """Put a new camera of the same model in the place of this one."""
        self._ask("replace", {})

    def photos_taken(self) -> int:
        """Return how many photos the camera took, by request and by hand."""
        return self._ask("count", {})

    def _ask(self, question: str, values: dict[str, int]) -> int:
        with self._lock:
            self._control.send((question, values))
            answer = self._control.recv()
        if isinstance(answer, str):
            raise ValueError(answer)
        return int(answer)


@contextmanager
def emulate_camera(
    photographs: Photographs, *, model: Model = "generic", exposure_s: float = 0.0, download_s: float = 0.0
) -> Iterator[EmulatedCamera]:
    """Run a camera in another process for as long as the context lasts.

    Parameters
    ----------
    photographs
        Called on a thread of this process for each photo; returns its whole file. One that is
        :class:`sim_backend.ptpip.sources.Exposing` is told when the shutter opens and closes.
    model
        Which camera to emulate.
    exposure_s, download_s
        How long the shutter is open, and how long it then takes until the host has the photo.

    Raises
    ------
    DeviceNotFoundError
        When the camera's process does not start.
    """
    control, their_control = _pipe()
    photos, their_photos = _pipe()
    theirs = (their_control.fileno(), their_photos.fileno())
    command = [
        sys.executable,
        "-m",
        "sim_backend.ptpip.process",
        model,
        str(exposure_s),
        str(download_s),
        *map(str, theirs),
    ]
    process = subprocess.Popen(command, pass_fds=theirs, stdin=subprocess.DEVNULL, start_new_session=True)
    their_control.close()
    their_photos.close()
    server = threading.Thread(target=_serve_photos, args=(photos, photographs), name="photos", daemon=True)
    server.start()
    try:
        try:
            if not control.poll(START_TIMEOUT_S):
                raise EOFError
            port = control.recv()
        except (EOFError, OSError):
            raise DeviceNotFoundError(f"emulated camera: {model} did not start; run it by hand to see why") from None
        yield EmulatedCamera(control, port)
    finally:
        control.close()  # the camera ends itself when its owner is gone
        try:
            process.wait(END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        server.join(END_TIMEOUT_S)
        photos.close()


def _pipe() -> tuple[Connection, Connection]:
    ours, theirs = socket.socketpair()
    return Connection(ours.detach()), Connection(theirs.detach())


def _serve_photos(photos: Connection, photographs: Photographs) -> None:
    exposing = as_exposing(photographs)
    while True:
        try:
            match photos.recv():
                case "open":
                    exposing.open_shutter()
                    photos.send_bytes(b"")
                case "close":
                    exposing.close_shutter()
                    photos.send_bytes(b"")
                case "develop":
                    photos.send_bytes(exposing.develop())
                case _:
                    photos.send_bytes(exposing())
        except (EOFError, OSError):
            return


class OwnersPhotos:
    """Photographs by asking the owner; one question at a time."""

    def __init__(self, photos: Connection) -> None:
        self._photos = photos
        self._lock = threading.Lock()

    def open_shutter(self) -> None:
        """Let the owner see from now on."""
        self._ask("open")

    def close_shutter(self) -> None:
        """Let the owner see no longer."""
        self._ask("close")

    def develop(self) -> bytes:
        """Return the file of what the owner saw."""
        return self._ask("develop")

    def __call__(self) -> bytes:
        """Return the file of a photo taken now."""
        return self._ask("photograph")

    def _ask(self, question: str) -> bytes:
        with self._lock:
            self._photos.send(question)
            return self._photos.recv_bytes()


def run(new_body: Callable[[], Body], control: Connection) -> None:
    """Serve a camera and answer its owner until the owner is gone."""
    body = new_body()
    responder = Responder(body)
    threading.Thread(target=responder.serve, name="listener", daemon=True).start()
    control.send(responder.port)
    while True:
        try:
            question, values = control.recv()
        except (EOFError, OSError):
            responder.close()
            return
        if question == "replace":
            body = new_body()
            responder.replace_body(body)
        control.send(_answer(body, responder, question, values))


def _answer(body: Body, responder: Responder, question: str, values: dict[str, int]) -> int | str:
    """Do what the owner asks; a sentence is a refusal."""
    if question == "count":
        return body.photos_taken
    if question == "break":
        responder.break_links()
    try:
        body.faults.update(values)
    except ValueError as error:
        return str(error)
    while body.faults.happens("stray"):
        body.press_shutter_by_hand()
    return 0


def main() -> None:
    """Run as the process of :func:`emulate_camera`."""
    parser = argparse.ArgumentParser(description="The other half of emulate_camera; not for people.")
    parser.add_argument("model", choices=MODELS)
    parser.add_argument("exposure_s", type=float)
    parser.add_argument("download_s", type=float)
    parser.add_argument("control", type=int)
    parser.add_argument("photos", type=int)
    given = parser.parse_args()
    photographs = OwnersPhotos(Connection(given.photos))
    body = BODIES[given.model]
    run(
        lambda: body(photographs, exposure_s=given.exposure_s, download_s=given.download_s),
        Connection(given.control),
    )
    os._exit(0)  # threads may wait for a host that never speaks again


if __name__ == "__main__":
    main()
