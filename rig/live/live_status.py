"""What the status page shows: how far the capture is, and what is thought of each sweep."""

import math
from collections import deque
from typing import Any

from rig.capturing.progress import CaptureProgress
from rig.config import RigConfig
from rig.live.live_quality import LiveQuality
from rig.planning.plan import set_name, set_order

NEWS_KEPT = 12


class LiveStatus:
    """Gathers the page's numbers; they are read from another thread than the capture's, and reading changes nothing."""

    def __init__(self, config: RigConfig, progress: CaptureProgress) -> None:
        self._config = config
        self._progress = progress
        self._news: deque[str] = deque(maxlen=NEWS_KEPT)
        self.quality: LiveQuality | None = None
        self.photos = 0
        self.photographing: tuple[str, str] | None = None

    def add(self, line: str) -> None:
        """Show a line of news; the latest stands first."""
        self._news.appendleft(line)

    def as_json(self) -> dict[str, Any]:
        """Return the whole page as plain values."""
        where = self._progress.where()
        return {
            "name": self._config.name,
            "length_unit": self._config.length_unit,
            "now": where.text,
            "share": where.share,
            "remaining_s": where.remaining_s,
            "photos": self.photos,
            "sweeps": [self._sweep(set_name(place), axis) for place in set_order(self._config) for axis in ("x", "y")],
            "news": list(self._news),
        }

    def _sweep(self, name: str, axis: str) -> dict[str, Any]:
        quality = self.quality
        verdict = quality.verdicts.get((name, axis)) if quality else None
        if (name, axis) == self.photographing:
            state = "photographing"
        elif quality is not None and (name, axis) in quality.pending():
            state = "decoding"
        elif verdict is None:
            state = "waiting"
        else:
            state = "again" if verdict.reasons else "good"
        found: dict[str, Any] = {"set": name, "axis": axis, "state": state, "reasons": [], "quality": None}
        if verdict is not None:
            shown = ("coverage", "saturated_share", "contrast", "misfit", "sd_px")
            found["quality"] = {field: finite(getattr(verdict.quality, field)) for field in shown}
            found["entry_sd_mm"] = finite(verdict.entry_sd_mm)
            found["reasons"] = list(verdict.reasons)
        return found


def finite(value: float) -> float | None:
    """Return a number that JSON can hold."""
    return value if math.isfinite(value) else None
