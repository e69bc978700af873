"""The camera's settings, frozen and read back at the start of each set: all sets of a session share them."""

import json
from collections.abc import Mapping

from drivers.protocols import Camera
from recon.sessions.journal import JOURNAL_NAME
from recon.sessions.session import SessionWriter
from rig.errors import CaptureError

EVENT = "camera_frozen"


class CameraFreeze:
    """Sets what is configured, and refuses what differs from the sets before, those of an interrupted capture included.

    ``wanted`` is what is set; ``settings`` are those of the present set, read back.
    """

    def __init__(self, camera: Camera, writer: SessionWriter, wanted: Mapping[str, str]) -> None:
        self._camera = camera
        self._journal = writer.journal
        self.wanted = dict(wanted)
        self._before = _last_frozen(writer)
        self._set_name = ""
        self.settings: dict[str, str] = {}

    def want(self, settings: Mapping[str, str]) -> None:
        """Set these as well, from now on."""
        self.wanted |= settings
        self._set_name = ""

    def for_set(self, set_name: str) -> None:
        """Set, read back, compare, and write down the camera's settings, where a set begins or goes on.

        Raises
        ------
        CaptureError
            A setting is not that of the session so far.
        DeviceError
            A setting did not take, or one would change from photo to photo.
        """
        if set_name == self._set_name:
            return
        self._camera.apply_settings(self.wanted)
        found = self._camera.settings()
        for name, before in (self._before or found).items():
            now = found.get(name)
            if now != before:
                raise CaptureError(
                    f"camera: {name} was {before!r} in this session so far, it is {now!r} at the start of {set_name}; all "
                    f"sets need the same exposure: set it back on the body or in [camera.settings], then resume"
                )
        self._journal.append("camera_frozen", set=set_name, settings=found)
        self._before = self.settings = found
        self._set_name = set_name


def _last_frozen(writer: SessionWriter) -> dict[str, str] | None:
    """Return the settings that the session's journal wrote down last, None in a fresh session."""
    last = None
    for line in (writer.folder / JOURNAL_NAME).read_text(encoding="utf-8").splitlines():
        if f'"{EVENT}"' in line:
            last = json.loads(line)["settings"]
    return last
