"""A long capture with a camera that misbehaves: ``python -m tests.bench.camera_soak`` prints JSON, ``--table`` Markdown.

The real driver and the real libgphoto2 photograph with an emulated body what a display shows: the frame tag of the photo's
number. Before every tenth photo on average one fault is set. A photo counts as recorded when the driver hands it over, its
Exif is that of the set, and its tag is that of the commanded frame, as in a capture; otherwise the frame is shown anew and
photographed again. Whether it was recorded rightly is judged by what only the emulator knows: which file it made of which
frame, and which of its files somebody released by hand.
"""

import argparse
import json
import logging
import random
import struct
import sys
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import simplejpeg

from drivers.errors import DeviceError
from drivers.gphoto2_camera import Gphoto2Camera
from drivers.protocols import Photo
from recon.patterns.frame_tag import ACROSS_CELLS, tag_levels
from recon.patterns.frame_tag_reading import read_tag
from rig.capturing.exposure_check import check_exposure
from sim_backend.exposure import blended
from sim_backend.ptpip.process import MODELS, EmulatedCamera, Model, emulate_camera
from sim_backend.ptpip.world_photos import numbered

FAULT_RATE = 0.1
TIMEOUT_S = 60.0
ATTEMPT_S = 2.0
SILENCE_S = 3.0
SETTINGS = {"generic": {"shutterspeed": "0.0625s"}, "canon-eos-40d": {"shutterspeed": "1/15"}}
EXPOSURE_S = 0.0625
# So long that a photo still comes while the next frame is shown, which is 0.36 s after the camera took the command.
DOWNLOAD_S = {"strict": 0.02, "overlap": 0.45}
CELL_PX, TAG_LEFT_PX, TAG_TOP_PX, COLUMNS, ROWS = 12, 40, 30, 320, 240

# Set before the exposure, and set between exposure and download.
BEFORE = ("busy", "stale", "truncated", "stray", "stray_in_capture", "dropped_link", "lost", "dial_turned", "silent")
DURING = ("stray", "dropped_link", "silent")
# What the driver, the Exif or the tag says, and the column of the table that it is.
NOTICES = (
    ("byte for byte the photo before", "old file"),
    ("ends before the end", "file cut short"),
    ("announced", "file cut short"),
    ("somebody took", "another photo came too"),
    ("no photo came", "no photo"),
    ("no answer within", "no answer"),
    ("has an exposure time", "Exif"),
    ("tag", "frame tag"),
    ("opened again for its download", "link broken"),
    ("it is opened again", "link broken"),
)


class TagDisplay:
    """A display that shows frame tags, and the sensor before it; implements :class:`sim_backend.ptpip.sources.Exposing`.

    ``made`` holds for each file whether it was released by command, and of which frames its light is.
    """

    def __init__(self) -> None:
        self.made: dict[bytes, tuple[bool, frozenset[int]]] = {}
        self._under = np.random.default_rng(1).integers(20, 60, (ROWS, COLUMNS), dtype=np.uint8)
        self._shown = 0
        self._opened_on = 0
        self._seen = (0, 0)
        self._lock = threading.Lock()

    def show(self, number: int) -> None:
        """Show the tag of a frame."""
        self._shown = number

    def open_shutter(self) -> None:
        self._opened_on = self._shown

    def close_shutter(self) -> None:
        self._seen = (self._opened_on, self._shown)

    def develop(self) -> bytes:
        first, last = self._seen
        picture = self._picture(last) if first == last else blended(self._picture(first), self._picture(last))
        return self._keep(picture, by_command=True, frames=frozenset(self._seen))

    def __call__(self) -> bytes:
        return self._keep(self._picture(self._shown), by_command=False, frames=frozenset({self._shown}))

    def _picture(self, number: int) -> bytes:
        tag = tag_levels(number, cell_px=CELL_PX)
        picture = self._under.copy()
        place = (slice(TAG_TOP_PX, TAG_TOP_PX + len(tag)), slice(TAG_LEFT_PX, TAG_LEFT_PX + len(tag)))
        picture[place] = 30 + (tag * 0.7).astype(np.uint8)
        return simplejpeg.encode_jpeg(picture[..., None], quality=92, colorspace="GRAY")

    def _keep(self, picture: bytes, *, by_command: bool, frames: frozenset[int]) -> bytes:
        with self._lock:
            data = numbered(picture, len(self.made) + 1)
            self.made[data] = (by_command, frames)
            return data


def tag_of(photo: Photo) -> int | None:
    """Return the frame number that a photo shows."""
    left, top, side = TAG_LEFT_PX - 0.5, TAG_TOP_PX - 0.5, ACROSS_CELLS * CELL_PX
    corners = np.array([[left, top], [left + side, top], [left + side, top + side], [left, top + side]])
    return read_tag(simplejpeg.decode_jpeg(photo.data, colorspace="GRAY")[..., 0], corners).number


def as_made(photo: Photo) -> bytes:
    """Return a photo's file without the Exif segment that the body put behind its start."""
    (length,) = struct.unpack_from(">H", photo.data, 4)
    return photo.data[:2] + photo.data[4 + length :]


@dataclass(slots=True)
class Outcome:
    """What became of one kind of fault: how often it was set, how it was noticed, how it was mended."""

    injected: int = 0
    noticed: Counter[str] = field(default_factory=Counter)
    mended: Counter[str] = field(default_factory=Counter)


class Soak:
    """One capture. Whatever is noticed counts for the fault that was set last."""

    def __init__(
        self, camera: Gphoto2Camera, body: EmulatedCamera, display: TagDisplay, *, seed: int, fault_rate: float
    ) -> None:
        self.outcomes: dict[str, Outcome] = defaultdict(Outcome)
        self.wrong_frames = 0
        self.by_hand = 0
        self._camera, self._body, self._display = camera, body, display
        self._rng = random.Random(seed)
        self._fault_rate = fault_rate
        self._fault = "none"
        self._said: set[str] = set()
        self._settings = camera.settings()

    def take(self, number: int, *, following: int) -> None:
        """Record one photo; ``following`` is shown while it is on its way."""
        before, during = None, None
        if self._rng.random() < self._fault_rate:
            drawn = self._rng.randrange(len(BEFORE) + len(DURING))
            before = BEFORE[drawn] if drawn < len(BEFORE) else None
            during = DURING[drawn - len(BEFORE)] if before is None else None
        counts = self._camera.counts
        while True:
            self._display.show(number)
            self._said = set()
            try:
                if before:
                    before = self._inject(before, before)
                self._camera.expose(timeout_s=TIMEOUT_S)
                self._display.show(following)
                if during:
                    during = self._inject(during, f"{during}, after the exposure")
                (photo,) = self._camera.collect(timeout_s=TIMEOUT_S)
                check_exposure((photo,), self._settings, name="photo")
                found = tag_of(photo)
                if found != number:
                    raise DeviceError(f"tag of {found} found, {number} commanded")
                break
            except DeviceError as error:
                self.notice(str(error))
                self._outcome.mended["frame shown and photographed again"] += 1
        self._judge(photo, number)
        now = self._camera.counts
        self._outcome.mended["camera opened again"] += now.recoveries - counts.recoveries
        self._outcome.mended["left out"] += now.strays - counts.strays
        self._outcome.mended["both left out, one more taken"] += now.retaken - counts.retaken

    @property
    def _outcome(self) -> Outcome:
        return self.outcomes[self._fault]

    def _judge(self, photo: Photo, number: int) -> None:
        by_command, frames = self._display.made.get(as_made(photo), (False, frozenset()))
        self.wrong_frames += frames != {number}
        self.by_hand += frames == {number} and not by_command

    def _inject(self, fault: str, name: str) -> None:
        self._fault = name
        self._outcome.injected += 1
        if fault == "silent":
            self._body.set_faults(silent=1)
            threading.Timer(SILENCE_S, self._body.set_faults, kwargs={"silent": 0}).start()
        elif fault == "dropped_link" and name != fault:
            self._body.pull_cable()
        else:
            self._body.set_faults(**{fault: 2 if fault == "truncated" else 1})

    def notice(self, sentence: str) -> None:
        """Count what was said of one exposure, once where the driver says it twice."""
        self._outcome.mended["downloaded again"] += "downloaded again" in sentence
        what = next((what for part, what in NOTICES if part in sentence), "link broken")
        self._outcome.noticed[what] += what not in self._said
        self._said.add(what)


class Notices(logging.Handler):
    """Passes the driver's warnings on: what it mends by itself it says there."""

    def __init__(self, notice: Callable[[str], None]) -> None:
        super().__init__(logging.WARNING)
        self._notice = notice

    def emit(self, record: logging.LogRecord) -> None:
        self._notice(record.getMessage())


def resident_mb(camera: Gphoto2Camera) -> float:
    """Return the memory of the process that libgphoto2 lives in."""
    process_id = camera._link.opened()._process.pid
    lines = Path(f"/proc/{process_id}/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


def soak(model: Model, mode: str, *, count: int, seed: int, fault_rate: float) -> dict[str, object]:
    """Record ``count`` photos with faults between them."""
    display, overlap = TagDisplay(), mode == "overlap"
    with (
        emulate_camera(display, model=model, exposure_s=EXPOSURE_S, download_s=DOWNLOAD_S[mode]) as body,
        Gphoto2Camera(body.address, kind="emulated", attempt_s=ATTEMPT_S, overlap=overlap) as camera,
    ):
        camera.apply_settings(SETTINGS[model])
        run = Soak(camera, body, display, seed=seed, fault_rate=fault_rate)
        handler = Notices(run.notice)
        logging.getLogger("drivers").addHandler(handler)
        logging.getLogger("drivers").propagate = False
        before_mb, slowest_s, started_s = resident_mb(camera), 0.0, time.monotonic()
        for number in range(count):
            begun_s = time.monotonic()
            run.take(number, following=number + 1)
            slowest_s = max(slowest_s, time.monotonic() - begun_s)
        elapsed_s, after_mb = time.monotonic() - started_s, resident_mb(camera)
        logging.getLogger("drivers").removeHandler(handler)
    return {
        "photos": count,
        "of_the_wrong_frame": run.wrong_frames,
        "right_frame_released_by_hand": run.by_hand,
        "shutter_releases": len(display.made),
        "photos_per_s": round(count / elapsed_s, 2),
        "slowest_photo_s": round(slowest_s, 2),
        "library_memory_mb": [round(before_mb, 1), round(after_mb, 1)],
        "faults": {
            name: {"injected": found.injected, "noticed": dict(+found.noticed), "mended": dict(+found.mended)}
            for name, found in sorted(run.outcomes.items())
            if found.injected or found.noticed
        },
    }


def table(results: dict[str, dict[str, dict]]) -> str:
    """Return the results in Markdown: a table of the captures, and one of the faults of all of them."""
    lines = [
        "| camera | mode | photos | of a wrong frame | of the right one, released by hand | shutter releases | faults set | "
        "slowest photo (s) |",
        "|---|---|---|---|---|---|---|---|",
    ]
    faults: dict[str, Outcome] = defaultdict(Outcome)
    for model, modes in results.items():
        for mode, found in modes.items():
            injected = sum(fault["injected"] for fault in found["faults"].values())
            lines.append(
                f"| {model} | {mode} | {found['photos']} | {found['of_the_wrong_frame']} | "
                f"{found['right_frame_released_by_hand']} | {found['shutter_releases']} | {injected} | "
                f"{found['slowest_photo_s']} |"
            )
            for name, fault in found["faults"].items():
                faults[name].injected += fault["injected"]
                faults[name].noticed.update(fault["noticed"])
                faults[name].mended.update(fault["mended"])
    lines += ["", "| fault | set | noticed by | mended |", "|---|---|---|---|"]
    lines += [
        f"| {name} | {found.injected} | {_counted(found.noticed) or 'the driver alone'} | "
        f"{_counted(found.mended) or 'asked again'} |"
        for name, found in sorted(faults.items())
    ]
    return "\n".join(lines)


def _counted(counter: Counter[str]) -> str:
    return ", ".join(f"{what} {count}" for what, count in counter.most_common())


def main() -> None:
    """Soak every model in both modes; end with 1 if a photo of a wrong frame was recorded."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--photos", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fault-rate", type=float, default=FAULT_RATE, help="faults a photo  [default: %(default)s]")
    parser.add_argument("--models", nargs="+", choices=MODELS, default=MODELS)
    parser.add_argument("--modes", nargs="+", choices=DOWNLOAD_S, default=list(DOWNLOAD_S))
    parser.add_argument("--table", type=Path, nargs="+", help="print Markdown of these results instead of soaking")
    given = parser.parse_args()
    if given.table:
        merged: dict[str, dict[str, dict]] = defaultdict(dict)
        for path in given.table:
            for model, modes in json.loads(path.read_text(encoding="utf-8")).items():
                merged[model] |= modes
        sys.stdout.write(table(merged) + "\n")
        return
    results = {
        model: {
            mode: soak(model, mode, count=given.photos, seed=given.seed, fault_rate=given.fault_rate)
            for mode in given.modes
        }
        for model in given.models
    }
    sys.stdout.write(json.dumps(results, indent=2) + "\n")
    raise SystemExit(any(found["of_the_wrong_frame"] for modes in results.values() for found in modes.values()))


if __name__ == "__main__":
    main()
