"""Did the scene stay as it was? Reference photos compared in the order in which they were taken, during a capture or after it.

Each is compared with the first one of its set. The first one of a set is compared with that of the session by its marks alone:
liquid and display's place change everything else. The noise is measured from the first two, which are taken in a row.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from recon.errors import SessionError
from recon.scene.photo_noise import Photo, PhotoNoise
from recon.scene.scene_change import Finding, Mask, Part, SceneLimits, SceneParts, findings, part_masks, scene_change
from recon.scene.scene_shift import PartShift, noise_of_pair
from recon.sessions.journal import JOURNAL_NAME, read_journal
from recon.sessions.photos import Counts, read_grey, saturation_count
from recon.sessions.session import Session

REFERENCE = "reference"
MEASURED_COLUMNS = 1000
# Where a session does not say what is too much.
USUAL_LIMITS = SceneLimits(shift_px=0.05, sigmas=6.0, light_share=0.02)
NO_REFERENCES = "could not be checked: the session has no reference photos"
ONE_REFERENCE = "could not be checked: it takes two reference photos of one set"
NO_MARKS = "sets could not be compared with each other: there are no marks in the photos"


@dataclass(frozen=True, slots=True)
class SceneCheck:
    """One comparison: the reference photo ``index`` of a set, with the set's first one or, ``across_sets``, the session's."""

    set_name: str
    index: int
    across_sets: bool
    parts: Mapping[Part, PartShift]
    findings: tuple[Finding, ...]


def reduction(columns: int) -> int:
    """Return how many photo pixels across and down are averaged into one before anything is measured.

    A thousand pixels across measure to a thousandth of a pixel; more would only take longer.
    """
    return max(1, round(columns / MEASURED_COLUMNS))


@dataclass(frozen=True, slots=True, eq=False)
class ReducedPhoto:
    """A photo as it is measured: averaged counts, and where none of them is clipped."""

    counts: Photo
    sound: Mask

    @classmethod
    def of(cls, counts: Counts) -> "ReducedPhoto":
        """Average ``counts`` by :func:`reduction`; what does not fill a whole pixel at the right and lower edge is left out."""
        factor = reduction(counts.shape[1])
        rows, columns = counts.shape[0] // factor, counts.shape[1] // factor
        whole = counts[: rows * factor, : columns * factor]
        clipped = (whole >= saturation_count(counts)).astype(np.float32)
        size = (columns, rows)
        return cls(
            cv2.resize(whole.astype(np.float32), size, interpolation=cv2.INTER_AREA),
            cv2.resize(clipped, size, interpolation=cv2.INTER_AREA) == 0,
        )


class SceneChecker:
    """Takes in reference photos one after the other and says what changed; keeps the first one of each set."""

    def __init__(self, parts: SceneParts, limits: SceneLimits, *, rows: int, columns: int) -> None:
        self.limits = limits
        self._factor = reduction(columns)
        self._masks = part_masks(
            parts.reduced(self._factor), rows=rows // self._factor, columns=columns // self._factor
        )
        self._firsts: dict[str, ReducedPhoto] = {}
        self._noise: PhotoNoise | None = None

    def see(self, set_name: str, index: int, counts: Counts, *, wet: bool) -> SceneCheck | None:
        """Compare the next reference photo; None where there is nothing yet to compare it with."""
        photo = ReducedPhoto.of(counts)
        first = self._firsts.setdefault(set_name, photo)
        if first is not photo:
            if self._noise is None:
                self._noise = _noise_of(first, photo)
            change = self._change(first, photo, self._masks)
            return SceneCheck(set_name, index, False, change, findings(change, self.limits, wet=wet))
        start = next(iter(self._firsts.values()))
        if start is photo or self._noise is None or "marks" not in self._masks:
            return None
        marks = self._change(start, photo, {"marks": self._masks["marks"]})
        return SceneCheck(set_name, index, True, marks, findings(marks, self.limits, wet=wet))

    def is_still(self, first: Counts, second: Counts) -> bool:
        """Whether two photos in a row differ by no more than half the limits allow."""
        half = SceneLimits(self.limits.shift_px / 2, self.limits.sigmas, self.limits.light_share / 2)
        change = self._change(ReducedPhoto.of(first), ReducedPhoto.of(second), self._masks)
        return not findings(change, half, wet=True)

    def _change(self, first: ReducedPhoto, second: ReducedPhoto, masks: Mapping[Part, Mask]) -> dict[Part, PartShift]:
        noise = self._noise or _noise_of(first, second)
        sound = {part: mask & first.sound & second.sound for part, mask in masks.items()}
        change = scene_change(first.counts, second.counts, sound, noise)
        return {part: shift.enlarged(self._factor) for part, shift in change.items()}


def _noise_of(first: ReducedPhoto, second: ReducedPhoto) -> PhotoNoise:
    return noise_of_pair(first.counts, second.counts, first.sound & second.sound)


@dataclass(frozen=True, slots=True)
class SceneReport:
    """Every comparison of a session in order; ``note`` says what could not be checked, empty where all was."""

    checks: tuple[SceneCheck, ...]
    note: str = ""


def check_scene(session: Session) -> SceneReport:
    """Compare all reference photos of a session; a session without any is no error."""
    keys = [key for key in session.photos if key[1] == REFERENCE]
    if not keys:
        return SceneReport((), NO_REFERENCES)
    parts, limits = parts_of_session(session)
    camera = session.manifest.camera
    checker = SceneChecker(parts, limits, rows=camera.rows, columns=camera.columns)
    checks = []
    for set_name, sweep, index in keys:
        counts = read_grey(
            session.photo_file(set_name, sweep, index),
            rows=camera.rows,
            cols=camera.columns,
            primary=session.manifest.display.primary,
        )
        wet = session.manifest.set_named(set_name).condition == "liquid"
        checks.append(checker.see(set_name, index, counts, wet=wet))
    made = tuple(check for check in checks if check is not None)
    return SceneReport(made, ONE_REFERENCE if not made else "" if parts.marks_px else NO_MARKS)


def parts_of_session(session: Session) -> tuple[SceneParts, SceneLimits]:
    """Return what the session's last ``watch_started`` says of parts and limits, or none and the usual ones."""
    parts, limits = SceneParts(), USUAL_LIMITS
    source = session.folder / JOURNAL_NAME
    for entry in read_journal(source):
        if entry["event"] != "watch_started":
            continue
        try:
            object_px = tuple((float(x), float(y)) for x, y in entry.get("object_px", ()))
            marks_px = tuple((float(a), float(b), float(c), float(d)) for a, b, c, d in entry.get("marks_px", ()))
            names = ("shift_px", "sigmas", "light_share")
            limits = SceneLimits(*(float(entry.get(name, getattr(USUAL_LIMITS, name))) for name in names))
        except (TypeError, ValueError):
            raise SessionError(
                f"{source}: watch_started needs object_px as pairs and marks_px as fours of numbers; correct or remove it"
            ) from None
        parts = SceneParts(object_px, marks_px)
    return parts, limits
