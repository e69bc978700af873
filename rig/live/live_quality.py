"""The quality of each sweep while the next is photographed, judged against the limits of section ``[live]``."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from recon.sessions.manifest import Manifest
from recon.sweeps.sweep_quality import SweepQuality, predicted_entry_sd_mm
from rig.capture_sections import Live
from rig.live.live_decoder import LiveDecoder

# A sweep of a thousand photos of ten megapixels decodes in under two minutes; this long, and something else is wrong.
LONGEST_DECODING_S = 1200.0


@dataclass(frozen=True, slots=True)
class SweepVerdict:
    """What is thought of one sweep: ``reasons`` are why it should be photographed again, empty where it is good.

    ``entry_sd_mm`` is the standard deviation of an entry point that it leads us to expect; NaN where that cannot be said.
    """

    quality: SweepQuality
    entry_sd_mm: float
    reasons: tuple[str, ...]

    def text(self) -> str:
        """Say it in one line."""
        one = self.quality
        parts = [f"{share_text(one.coverage)} of {one.lit_pixels} lit pixels matched"]
        parts += [f"contrast {number_text(one.contrast)}", f"clipped {share_text(one.saturated_share)}"]
        parts += [f"misfit {number_text(one.misfit)}", f"place sd {number_text(one.sd_px)} px"]
        if math.isfinite(self.entry_sd_mm):
            parts.append(f"entry point sd about {number_text(self.entry_sd_mm)} mm")
        return f"{one.set} {one.axis}: {'again: ' + '; '.join(self.reasons) if self.reasons else 'good'} ({', '.join(parts)})"


def judge(quality: SweepQuality, limits: Live, manifest: Manifest) -> SweepVerdict:
    """Compare a sweep with the limits. A sweep that nobody saw is bad whatever they are."""
    entry_sd_mm = math.nan
    if limits.object_distance_mm is not None:
        entry_sd_mm = predicted_entry_sd_mm(quality.sd_px, manifest, object_distance_mm=limits.object_distance_mm)
    return SweepVerdict(quality, entry_sd_mm, tuple(_reasons(quality, limits, entry_sd_mm)))


def _reasons(quality: SweepQuality, limits: Live, entry_sd_mm: float) -> list[str]:
    if quality.lit_pixels == 0:
        return ["no pixel saw the stripe (look at the display, the lens cap and the exposure)"]
    reasons = []
    if quality.coverage < limits.least_coverage:
        reasons.append(
            f"{share_text(quality.coverage)} of the lit pixels are matched, {share_text(limits.least_coverage)} asked "
            "(did something move or flicker?)"
        )
    if quality.saturated_share > limits.largest_saturated_share:
        reasons.append(
            f"{share_text(quality.saturated_share)} of the lit pixels are clipped, at most "
            f"{share_text(limits.largest_saturated_share)} asked (shorten the exposure)"
        )
    if quality.contrast < limits.least_contrast:
        reasons.append(
            f"the contrast is {number_text(quality.contrast)}, {limits.least_contrast:g} asked (darken the room)"
        )
    if quality.misfit > limits.largest_misfit:
        reasons.append(
            f"the curves miss the stripe's by {number_text(quality.misfit)}, at most {limits.largest_misfit:g} asked "
            "(did something move?)"
        )
    if quality.dark_gap > limits.largest_dark_share * quality.photos:
        reasons.append(f"{quality.dark_gap} photos in a row show no stripe (did the display go dark?)")
    if limits.largest_entry_sd_mm is not None and entry_sd_mm > limits.largest_entry_sd_mm:
        reasons.append(
            f"entry points are expected to {number_text(entry_sd_mm)} mm, {limits.largest_entry_sd_mm:g} mm asked "
            "(more light or smaller steps help)"
        )
    return reasons


class LiveQuality:
    """Asks for a verdict on each sweep as soon as its last photo is saved; ``on_news`` gets what else there is to say."""

    def __init__(
        self,
        decoder: LiveDecoder,
        limits: Live,
        manifest: Manifest,
        *,
        on_verdict: Callable[[SweepVerdict], None],
        on_news: Callable[[str], None],
    ) -> None:
        self._decoder = decoder
        self._limits = limits
        self._manifest = manifest
        self._on_verdict = on_verdict
        self._on_news = on_news
        self._asked: set[tuple[str, str]] = set()
        self._lost = False
        self.verdicts: dict[tuple[str, str], SweepVerdict] = {}
        self.entry_points: dict[str, Any] | None = None

    def pending(self) -> frozenset[tuple[str, str]]:
        """Return the sweeps that are being decoded."""
        return frozenset(self._asked)

    def sweep_taken(self, set_name: str, axis: str) -> None:
        """Begin to decode a sweep whose photos are all saved."""
        self.verdicts.pop((set_name, axis), None)
        self._asked.add((set_name, axis))
        self._decoder.ask({"set": set_name, "axis": axis})
        self.poll()

    def poll(self) -> None:
        """Take in what has been decoded, without waiting."""
        self._take(self._decoder.answers())

    def wait(self, *, on_poll: Callable[[], None]) -> None:
        """Wait until every sweep asked for has its verdict, or the decoding is lost."""
        self._take(self._decoder.wait(timeout_s=LONGEST_DECODING_S, on_poll=on_poll))
        self._asked.clear()

    def ask_for_entry_points(self) -> None:
        """Begin to cross the paths of all four sets."""
        self._decoder.ask({"cross": True})

    def _take(self, answers: list[dict[str, Any]]) -> None:
        for answer in answers:
            if not answer.get("cross"):
                self._asked.discard((answer["set"], answer["axis"]))
            if "error" in answer:
                self._on_news(f"live decoding: {answer['error']}")
            elif answer.get("cross"):
                self.entry_points = answer
                self._on_news(_entry_points_text(answer))
            else:
                verdict = judge(SweepQuality(**answer["quality"]), self._limits, self._manifest)
                self.verdicts[answer["set"], answer["axis"]] = verdict
                self._on_verdict(verdict)
        if self._decoder.failure and not self._lost:
            self._lost = True
            self._asked.clear()
            self._on_news(self._decoder.failure)


def _entry_points_text(answer: dict[str, Any]) -> str:
    sd = "" if answer["sd_mm"] is None else f", their median sd {number_text(answer['sd_mm'])} mm"
    return f"all four sets: {answer['entry_points']} entry points of {answer['matched']} matched pixels{sd}"


def share_text(share: float) -> str:
    """Write a share as per cent."""
    return f"{share:.1%}".replace("%", " %") if math.isfinite(share) else "an unknown share"


def number_text(value: float) -> str:
    """Write a number with two significant digits."""
    return f"{value:.2g}" if math.isfinite(value) else "unknown"
