"""Watches that the scene stays as it was: looks at every reference photo, and waits until the picture is still."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from drivers.protocols import Clock, Photo
from recon.errors import SessionError
from recon.media.stated_index import PROVISIONAL_N
from recon.scene.scene_change import Finding, SceneLimits, SceneParts
from recon.scene.scene_check import REFERENCE, SceneCheck, SceneChecker
from recon.scene.scene_error import ErrorScale, typical_scale
from recon.sessions.photos import Counts, decode_grey, read_grey
from recon.sessions.session import SessionWriter, open_session
from rig.capture_sections import Watch
from rig.capturing.tag_check import DECODABLE
from rig.config import RigConfig
from rig.errors import SceneMovedError
from rig.planning.steps import TakePhoto

Response = Literal["go on", "warn", "retake", "stop"]
RESPONSES: tuple[Response, ...] = ("go on", "warn", "retake", "stop")
TRY = {
    "camera": "tighten the tripod and start a new session: photos from before do not fit those from now on",
    "object": "fasten the object and start a new session: photos from before do not fit those from now on",
    "display": "fasten the display on its stage, then resume; if it cannot go back to where it was, start a new session",
    "liquid": "look for bubbles, leaks and vibration, then resume",
    "light": "let the display warm up, switch its automatic brightness off, and let no other light in, then resume",
    "camera or display": "fasten both and start a new session; printed marks beside the object would tell which it was",
    "camera or object": "fasten both and start a new session: photos from before do not fit those from now on",
}


@dataclass(frozen=True, slots=True)
class SceneOutcome:
    """What a reference photo leads to, and the sentence for the operator, empty where all is well."""

    response: Response
    text: str = ""


def decide(findings: Sequence[Finding], watch: Watch, *, scale: ErrorScale | None, tries_left: bool) -> SceneOutcome:
    """Return the answer to what was found: the strictest that the configuration has for any of it.

    ``tries_left``: whether the sweep may be taken again; if not, where that would be the answer, the capture stops.
    """
    worst, texts = 0, []
    for found in findings:
        response: Response = watch.when_moved
        if found.cause == "light":
            response = watch.when_light_changed
        elif found.cause == "liquid":
            response = watch.when_liquid_moves
        if response == "retake" and not tries_left:
            response = "stop"
        worst = max(worst, RESPONSES.index(response))
        texts.append(f"{found.text}{_error_text(found, scale)}; {TRY[found.cause]}")
    return SceneOutcome(RESPONSES[worst], "; ".join(texts))


def error_mm(found: Finding, scale: ErrorScale | None) -> float | None:
    """Return how far off the entry points of a set with this shift would be; None where it cannot be said."""
    if scale is None or found.cause == "light":
        return None
    return scale.error_mm(found.shift_px, of_display=found.part == "display")


def _error_text(found: Finding, scale: ErrorScale | None) -> str:
    off_mm = error_mm(found, scale)
    return "" if off_mm is None else f", which puts entry points off by up to about {off_mm:.2g} mm"


class SceneWatch:
    """Compares the reference photos of one session; ``watch`` is the configuration's section of that name."""

    def __init__(self, watch: Watch, config: RigConfig, writer: SessionWriter, *, clock: Clock) -> None:
        self._watch = watch
        self._config = config
        self._writer = writer
        self._clock = clock
        self._scale = typical_scale(
            config.camera,
            config.display_poses,
            n_liquid=(config.liquid.n or PROVISIONAL_N) if config.liquid else (config.object.n or 1.5),
            n_air=config.n_air,
        )
        self._limits = SceneLimits(watch.shift_px, watch.sigmas, watch.light_share)
        self._checker: SceneChecker | None = None
        self._swept: tuple[str, str] | None = None
        self._tries: dict[tuple[str, str], int] = {}

    def photo_saved(self, photo: TakePhoto) -> tuple[SceneOutcome, tuple[str, str] | None]:
        """Look at a photo that was just saved; return the outcome and, for "retake", set and axis of the void sweep."""
        if photo.sweep != REFERENCE:
            self._swept = (photo.set_name, photo.sweep) if photo.sweep in ("x", "y") else self._swept
            return SceneOutcome("go on"), None
        swept, self._swept = self._swept, None
        swept = swept if swept is not None and swept[0] == photo.set_name else None
        tried = swept or photo.key[:2]
        outcome = self.check(photo, tries_left=self._tries.get(tried, 1) < self._watch.attempts)
        if outcome.response != "retake":
            return outcome, None
        self._tries[tried] = self._tries.get(tried, 1) + 1
        if swept is not None:
            self._writer.reject_sweep(*swept, reason=outcome.text)
        return outcome, swept

    def check(self, photo: TakePhoto, *, tries_left: bool) -> SceneOutcome:
        """Compare one saved reference photo with the first one of its set, and write what was found into the journal."""
        session = open_session(self._writer.folder)
        path = session.photo_file(*photo.key)
        if path.suffix.lower() not in DECODABLE:
            return SceneOutcome("warn", f"the scene cannot be watched: {path.name} is not a JPEG, PNG or TIFF")
        if self._checker is None:
            self._checker = self._begun()
            for key in [key for key in session.photos if key[1] == REFERENCE and key != photo.key]:
                with suppress(SessionError):  # one that was lost is missed only by the comparison with it
                    self._checker.see(key[0], key[2], self._read(session.photo_file(*key)), wet=_is_wet(key[0]))
        found = self._checker.see(photo.set_name, photo.index, self._read(path), wet=_is_wet(photo.set_name))
        if found is None:
            return SceneOutcome("go on")
        outcome = decide(found.findings, self._watch, scale=self._scale, tries_left=tries_left)
        self._journal_check(found, outcome)
        return outcome

    def wait_until_still(
        self, reason: str, *, snap: Callable[[], tuple[Photo, ...]], tell: Callable[[str], None]
    ) -> None:
        """Take photos, which are not kept, until a few in a row are alike to within noise.

        Raises
        ------
        SceneMovedError
            They are not after the longest time that the configuration allows.
        """
        checker = self._checker or self._new_checker()
        begun_s = self._clock.now_s()
        last, photos, alike = self._decoded(snap()), 1, 0
        while last is not None and alike < self._watch.still_photos:
            waited_s = self._clock.now_s() - begun_s
            if waited_s > self._watch.longest_wait_s:
                self._journal_wait(reason, waited_s, photos, still=False)
                raise SceneMovedError(
                    f"{reason}, and after {waited_s:.0f} s the picture is still not the same from photo to photo; look for "
                    "bubbles, leaks and vibration, then resume, or raise watch.longest_wait_s"
                )
            tell(f"{reason}: waiting until the picture is still ({waited_s:.0f} s)")
            now = self._decoded(snap())
            photos += 1
            alike = alike + 1 if now is not None and checker.is_still(last, now) else 0
            last = now
        self._journal_wait(reason, self._clock.now_s() - begun_s, photos, still=last is not None)

    def _begun(self) -> SceneChecker:
        watch = self._watch
        self._writer.journal.append(
            "watch_started", object_px=watch.object_px, marks_px=watch.marks_px, **asdict(self._limits)
        )
        return self._new_checker()

    def _new_checker(self) -> SceneChecker:
        camera = self._config.camera
        parts = SceneParts(self._watch.object_px, self._watch.marks_px)
        return SceneChecker(parts, self._limits, rows=camera.rows, columns=camera.columns)

    def _read(self, path: Path) -> Counts:
        camera = self._config.camera
        return read_grey(path, rows=camera.rows, cols=camera.columns, primary=self._config.display.primary)

    def _decoded(self, files: tuple[Photo, ...]) -> Counts | None:
        file = next((file for file in files if file.suffix.lower() in DECODABLE), None)
        return None if file is None else decode_grey(file.data, Path(file.name), primary=self._config.display.primary)

    def _journal_check(self, found: SceneCheck, outcome: SceneOutcome) -> None:
        named: list[dict[str, Any]] = [
            {**asdict(one), "text": one.text, "error_mm": error_mm(one, self._scale)} for one in found.findings
        ]
        self._writer.journal.append(
            "scene_checked",
            set=found.set_name,
            index=found.index,
            across_sets=found.across_sets,
            parts={part: asdict(shift) for part, shift in found.parts.items()},
            findings=named,
            response=outcome.response,
        )

    def _journal_wait(self, reason: str, waited_s: float, photos: int, *, still: bool) -> None:
        self._writer.journal.append(
            "waited_until_still", reason=reason, waited_s=round(waited_s, 1), photos=photos, still=still
        )


def _is_wet(set_name: str) -> bool:
    return set_name.endswith("_liquid")
