"""The exposure of a capture: chosen once, told to the freeze, kept in the journal, and looked at again in each set."""

from dataclasses import asdict
from pathlib import Path

from drivers.protocols import Camera, Photo
from recon.errors import ReconError
from recon.sessions.journal import JOURNAL_NAME, read_journal
from recon.sessions.photos import Counts, decode_grey
from recon.sessions.session import SessionWriter, open_session
from rig.capture_sections import AutoExposure
from rig.capturing.auto_exposure import Brightness, ChosenExposure, brightness_of, choose_time, fault_of, usable_times
from rig.capturing.causes import part_of_rig
from rig.capturing.photo_taker import PhotoTaker
from rig.capturing.progress import CaptureProgress
from rig.config import RigConfig
from rig.errors import CaptureError
from rig.planning.steps import TakePhoto

EVENT = "exposure_chosen"


class ExposureKeeper:
    """Chooses the exposure time before the first photo, and looks after it in each set's white photo."""

    def __init__(
        self,
        wanted: AutoExposure,
        config: RigConfig,
        camera: Camera,
        writer: SessionWriter,
        photos: PhotoTaker,
        *,
        progress: CaptureProgress,
    ) -> None:
        self._wanted = wanted
        self._config = config
        self._camera = camera
        self._writer = writer
        self._photos = photos
        self._progress = progress

    def choose(self, white: TakePhoto) -> None:
        """Choose the time with photos of the frame of ``white``, which are not kept; they stand in the journal as numbers.

        Raises
        ------
        CaptureError
            No time that the body offers holds whole refresh periods, or the photos cannot be read.
        """
        wanted = self._wanted
        with part_of_rig("camera"):
            choices = self._camera.setting_choices(wanted.setting)
        if choices:
            chosen = self._choose(choices, white)
        else:
            found = self._photograph(white)
            bad = fault_of(found, wanted, where="the white display")
            chosen = ChosenExposure(
                "", found, f"{bad}; this camera's {wanted.setting} can only be set on its body" if bad else ""
            )
        self._writer.journal.append(
            "exposure_chosen", setting=wanted.setting, value=chosen.value, **asdict(chosen.brightness)
        )
        if chosen.value:
            self._photos.set_camera({wanted.setting: chosen.value})
            self._progress.say(
                f"exposure: {chosen.value} s, white reaches {chosen.brightness.brightest:.0%} of the range"
            )
        if chosen.warning:
            self._progress.say(chosen.warning)

    def resume(self) -> None:
        """Go on with the exposure that the session began with."""
        for entry in read_journal(self._writer.folder / JOURNAL_NAME):
            if entry["event"] == EVENT and entry.get("value"):
                self._photos.set_camera({str(entry["setting"]): str(entry["value"])})

    def look_at(self, photo: TakePhoto) -> None:
        """Look at a set's white photo, which liquid makes brighter, and say if it is clipped or too dark."""
        file = open_session(self._writer.folder).photo_file(*photo.key)
        found = brightness_of(self._counts(file.read_bytes(), file), self._wanted.seen_px)
        self._writer.journal.append("exposure_checked", set=photo.set_name, **asdict(found))
        bad = fault_of(found, self._wanted, where=f"the white photo of {photo.set_name}")
        if bad:
            self._progress.say(bad)

    def _choose(self, choices: tuple[str, ...], white: TakePhoto) -> ChosenExposure:
        wanted = self._wanted
        times = usable_times(choices, refresh_hz=wanted.refresh_hz)
        if not times:
            raise CaptureError(
                f"exposure: none of the times that this camera offers for {wanted.setting} ({choices[0]} … {choices[-1]}) holds "
                f"whole refresh periods of {wanted.refresh_hz:g} Hz; correct capture.auto_exposure.refresh_hz, or leave the "
                "section out and set the time in [camera.settings]"
            )

        def brightness_at(time: str) -> Brightness:
            self._progress.tell(f"trying an exposure of {time} s")
            with part_of_rig("camera"):
                self._camera.apply_settings({wanted.setting: time})
            return self._photograph(white)

        return choose_time(times, wanted=wanted, brightness_at=brightness_at)

    def _photograph(self, white: TakePhoto) -> Brightness:
        files = self._photos.snap(white)
        return brightness_of(self._counts_of(files), self._wanted.seen_px)

    def _counts_of(self, files: tuple[Photo, ...]) -> Counts:
        readable = [file for file in files if file.suffix.lower() in (".jpg", ".jpeg", ".png", ".tif", ".tiff")]
        if not readable:
            raise CaptureError(
                "exposure: the camera gives RAW files only, whose brightness cannot be read here; let it write JPEG as well, or "
                "leave out [capture.auto_exposure]"
            )
        return self._counts(readable[-1].data, Path(readable[-1].name))

    def _counts(self, data: bytes, name: Path) -> Counts:
        try:
            return decode_grey(data, name, primary=self._config.display.primary)
        except ReconError as error:
            raise CaptureError(f"exposure: {error}") from error
