"""A camera that libgphoto2 has opened: expose, download, keep awake. Lives in the worker process alone."""

import contextlib
import socket
import time
from collections.abc import Callable
from typing import Any

from drivers import camera_settings
from drivers.camera_settings import RefusedError

BUSY = -110
BUSY_PAUSES_S = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
# How often the camera is asked for news. libgphoto2 itself asks an EOS every 50 to 200 ms, which is a tenth of a photo, and
# returns from a generic PTP camera at once, whatever time it is given.
POLL_S = 0.01
WAIT_MS = 1
# Of the time for a photo, the share spent on waiting for one that came too late for the photo before.
DEBT_SHARE = 1 / 3
Path = tuple[str, str]


class LateError(Exception):
    """The time of a call ran out while the camera still answers."""


def library_version() -> str:
    """Return the version of libgphoto2, such as ``2.5.34``; raises ``ImportError`` where it is not installed."""
    import gphoto2

    version: str = gphoto2.gp_library_version(gphoto2.GP_VERSION_SHORT)[0]
    return version


class OpenCamera:
    """Every public method but ``begin`` is one operation that the driver may ask for."""

    def __init__(self) -> None:
        import gphoto2  # in this module alone: nobody else needs the library

        self.gp: Any = gphoto2
        self._camera: Any = None
        self._end_s = 0.0
        self._owed = 0  # files of an exposure that was given up and may still come
        self._spent: list[Path] = []

    def begin(self, limit_s: float) -> None:
        """Give the operation that follows this much time."""
        self._end_s = time.monotonic() + limit_s

    def open(self, *, address: str) -> dict[str, str]:
        """Open the camera at ``address`` and say who it is."""
        model, port, abilities, ports = self._find(address)
        camera = self.gp.Camera()
        camera.set_abilities(abilities[abilities.lookup_model(model)])
        camera.set_port_info(ports[ports.lookup_path(port)])
        camera.init()
        self._camera = camera
        found = self.settings(names=("manufacturer", "cameramodel", "deviceversion", "serialnumber"))
        return {
            "model": model,
            "port": port,
            "library": library_version(),
            **found,
        }

    def _find(self, address: str) -> tuple[str, str, Any, Any]:
        """Return libgphoto2's model and port for ``address``, and its lists; a bare ``usb:`` is the only camera there is."""
        abilities, ports = self.gp.CameraAbilitiesList(), self.gp.PortInfoList()
        abilities.load()
        ports.load()
        if address.startswith("ptpip:"):
            host, *numbers = address.removeprefix("ptpip:").split(":")
            try:
                numeric = socket.gethostbyname(host)  # libgphoto2 takes dotted numbers only
            except OSError:
                raise RefusedError(f"no host is called {host!r}; write its number, such as 192.168.1.1") from None
            return "PTP/IP Camera", ":".join(["ptpip", numeric, *numbers]), abilities, ports
        found = [(model, port) for model, port in abilities.detect(ports) if address in ("usb:", port)]
        if not found:
            raise self.gp.GPhoto2Error(self.gp.GP_ERROR_MODEL_NOT_FOUND)
        if len(found) > 1:
            listed = ", ".join(f"{model} at {port}" for model, port in found)
            raise RefusedError(f"there are {len(found)} cameras: {listed}; name one of these addresses")
        return found[0][0], found[0][1], abilities, ports

    def reset_port(self, *, address: str) -> None:
        """Reset the USB port, as plugging in again would; the camera must be opened afterwards."""
        _model, path, _abilities, ports = self._find(address)
        port = self.gp.GPPort()
        port.set_info(ports[ports.lookup_path(path)])
        port.open()
        try:
            port.reset()
        finally:
            port.close()

    def close(self) -> None:
        """Give the camera back."""
        if self._camera is not None:
            self._delete_spent()
            self._camera.exit()
            self._camera = None

    def settings(self, *, names: tuple[str, ...]) -> dict[str, str]:
        """Return those of the named settings that this camera has."""
        values = {name: camera_settings.read_setting(self.gp, self._camera, name) for name in names}
        return {name: value for name, value in values.items() if value is not None}

    def choices(self, *, name: str) -> tuple[str, ...]:
        """Return the values that a setting may take."""
        return camera_settings.read_choices(self.gp, self._camera, name)

    def apply(self, *, settings: dict[str, str]) -> dict[str, str]:
        """Set and read back; nothing is set unless every name and value is one that the camera has."""
        return camera_settings.apply_settings(self.gp, self._camera, settings, patiently=self._patiently)

    def _patiently(self, act: Callable[[], Any]) -> None:
        """Do something; while the camera is busy, let it come to itself and try again."""
        for pause_s in (*BUSY_PAUSES_S, None):
            try:
                act()
                return
            except self.gp.GPhoto2Error as error:
                if error.code != BUSY or pause_s is None or time.monotonic() + pause_s > self._end_s:
                    raise
            time.sleep(pause_s)

    # Photos

    def expose(self, *, files: int, deletes: bool) -> dict[str, Any]:
        """Take a photo and wait until the camera has announced its files: then its shutter has closed.

        Returns ``paths``; ``strays``, how many photos were found that nobody here asked for; and ``mixed``, whether one of
        these came together with the photo, so that neither can be trusted.
        """
        strays = self.release(files=files, deletes=deletes)["strays"]
        announced = self._announced(files, deletes)
        return {**announced, "strays": strays + announced["strays"]}

    def release(self, *, files: int, deletes: bool) -> dict[str, Any]:
        """Take a photo; returns when the camera has accepted the command.

        Returns ``strays``, how many photos came before, and ``asked_s``, when the camera was told, on the clock of
        :func:`time.monotonic`, which all processes of a machine share.
        """
        self._wait_for_debt(deletes)
        strays = self._discard(self._drain(), deletes)
        self._delete_spent()
        asked_s = self._trigger()
        self._owed = files
        return {"strays": strays, "asked_s": asked_s}

    def fetch(self, *, files: int, deletes: bool) -> dict[str, Any]:
        """Wait for the files of a photo that was released, and download them: what ``expose`` and ``collect`` return.

        ``strays`` came before the files were complete, ``late_strays`` afterwards.
        """
        announced = self._announced(files, deletes)
        if announced["mixed"]:
            return {**announced, "files": [], "late_strays": 0}
        collected = self.collect(paths=announced["paths"])
        return {**announced, "files": collected["files"], "late_strays": collected["strays"]}

    def _announced(self, files: int, deletes: bool) -> dict[str, Any]:
        """Wait for the files of a photo that was released."""
        found: list[Path] = []
        while len(found) < files:
            found += self._next_files(self._end_s)
        found += self._drain()
        self._owed = 0
        if time.monotonic() > self._end_s:
            self._discard(found, deletes)
            raise LateError("the photo came later than that; allow more time")
        mixed = len({name.rpartition(".")[2].lower() for _folder, name in found}) < len(found)
        strays = self._discard(found, deletes) - files if mixed else 0
        return {"paths": [] if mixed else found, "strays": strays, "mixed": mixed}

    def _trigger(self) -> float:
        """Take a photo and return when it was asked for; a full card is told apart from failures without a reason."""
        asked_s = 0.0

        def ask() -> None:
            nonlocal asked_s
            asked_s = time.monotonic()
            self._camera.trigger_capture()

        try:
            self._patiently(ask)
            return asked_s
        except self.gp.GPhoto2Error as error:
            if error.code == self.gp.GP_ERROR and self._card_is_full():
                raise self.gp.GPhoto2Error(self.gp.GP_ERROR_NO_MEMORY) from error
            raise

    def _card_is_full(self) -> bool:
        try:
            stores = self._camera.get_storageinfo()
        except self.gp.GPhoto2Error:
            return False
        known = [store for store in stores if store.fields & self.gp.GP_STORAGEINFO_FREESPACEKBYTES]
        return bool(known) and all(store.freekbytes == 0 for store in known)

    def _next_files(self, end_s: float) -> list[Path]:
        """Return the next file that is announced, or an empty list after a moment."""
        left_s = end_s - time.monotonic()
        if left_s <= 0:
            raise LateError("no photo came; allow more time than the exposure takes, and look at focus and card")
        kind, data = self._camera.wait_for_event(WAIT_MS)
        if kind == self.gp.GP_EVENT_FILE_ADDED:
            return [(data.folder, data.name)]
        if kind == self.gp.GP_EVENT_TIMEOUT:
            time.sleep(POLL_S)
        return []

    def _drain(self) -> list[Path]:
        """Return the files that were announced up to now."""
        found: list[Path] = []
        while True:
            kind, data = self._camera.wait_for_event(1)
            if kind == self.gp.GP_EVENT_TIMEOUT:
                return found
            if kind == self.gp.GP_EVENT_FILE_ADDED:
                found.append((data.folder, data.name))

    def _wait_for_debt(self, deletes: bool) -> None:
        """Wait a while for the photo of an exposure that was given up, so that it is not taken for the next one."""
        now_s = time.monotonic()
        patience_s = now_s + DEBT_SHARE * (self._end_s - now_s)
        found: list[Path] = []
        with contextlib.suppress(LateError):
            while len(found) < self._owed:
                found += self._next_files(patience_s)
        self._owed = 0
        self._discard(found, deletes)

    def _discard(self, paths: list[Path], deletes: bool) -> int:
        self._spent += paths if deletes else []
        return len(paths)

    def _delete_spent(self) -> None:
        for folder, name in self._spent:
            with contextlib.suppress(self.gp.GPhoto2Error):  # it may be gone already
                self._camera.file_delete(folder, name)
        self._spent = []

    def collect(self, *, paths: list[Path]) -> dict[str, Any]:
        """Download files: each as name, bytes, and the length that the camera announces; and count uninvited photos."""
        strays = len(self._drain())
        files = []
        for folder, name in paths:
            # Held in a variable: the memory that get_data_and_size shows goes away with its CameraFile.
            file = self._camera.file_get(folder, name, self.gp.GP_FILE_TYPE_NORMAL)
            data = bytes(file.get_data_and_size())
            files.append((name, data, self._announced_bytes(folder, name)))
        if time.monotonic() > self._end_s:
            raise LateError("the download took longer than that; allow more time")
        return {"files": files, "strays": strays}

    def _announced_bytes(self, folder: str, name: str) -> int | None:
        try:
            info = self._camera.file_get_info(folder, name).file
        except self.gp.GPhoto2Error:
            return None
        return int(info.size) if info.fields & self.gp.GP_FILE_INFO_SIZE else None

    def spend(self, *, paths: list[Path]) -> None:
        """Remember photos that are safe with the host; they are deleted before the next one is taken."""
        self._spent += paths

    def drain(self) -> int:
        """Let the camera say what it has to say, which keeps it awake; count the photos that nobody asked for."""
        return len(self._drain())

    def preview(self) -> bytes:
        """Return one frame of live view."""
        file = self._camera.capture_preview()
        return bytes(file.get_data_and_size())
