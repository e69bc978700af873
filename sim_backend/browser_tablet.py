"""A tablet played by Chromium: it opens the display's page, and what its screen shows can be looked at."""

import base64

import cv2
import numpy as np
from jaxtyping import UInt8

from drivers.errors import DeviceError
from drivers.protocols import Axis, Frame, Patch
from sim_backend.chromium import Chromium

Levels = UInt8[np.ndarray, "rows columns"]


class BrowserTablet:
    """One page on a screen of ``columns`` × ``rows`` device pixels."""

    def __init__(self, chromium: Chromium, *, columns: int, rows: int) -> None:
        self._chromium = chromium
        target = chromium.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = str(chromium.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"])
        self._call("Emulation.setDeviceMetricsOverride", width=columns, height=rows, deviceScaleFactor=1, mobile=False)

    def open(self, url: str) -> None:
        """Open the display's page."""
        answer = self._call("Page.navigate", url=url)
        if answer.get("errorText"):
            raise DeviceError(f"tablet: Chromium cannot open the display's page: {answer['errorText']}")

    def frame(self) -> Frame:
        """Return what the screen shows now, as its compositor drew it, in the words of a frame."""
        data = base64.b64decode(str(self._call("Page.captureScreenshot", format="png")["data"]))
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        if picture is None:
            raise DeviceError("tablet: Chromium's picture of its screen cannot be read")
        # Drive levels light one primary or all three alike; either way the brightest channel is the level.
        return frame_of_picture(picture.max(axis=2))

    def _call(self, method: str, **parameters: object) -> dict[str, object]:
        return self._chromium.call(method, session=self._session, **parameters)


def frame_of_picture(levels: Levels) -> Frame:
    """Return the frame that draws exactly ``levels``, in the fewest words.

    That is levels along an axis, with one patch around whatever differs from them, or else the whole image. A picture of one
    level is told along x.
    """
    frames = [_along(levels, "x"), _along(levels, "y")]
    best = min(frames, key=_patched_px)
    return best if _patched_px(best) < levels.size // 2 else Frame(image=levels)


def _patched_px(frame: Frame) -> int:
    return sum(patch.levels.size for patch in frame.patches)


def _along(levels: Levels, axis: Axis) -> Frame:
    across = 0 if axis == "x" else 1
    under = np.median(levels, axis=across).astype(np.uint8)
    other = np.argwhere(levels != np.expand_dims(under, across))
    if not len(other):
        return Frame(axis=axis, levels=under)
    (top, left), (bottom, right) = other.min(axis=0), other.max(axis=0) + 1
    return Frame(axis=axis, levels=under, patches=(Patch(int(left), int(top), levels[top:bottom, left:right].copy()),))
