"""What rig and page say to each other over the socket.

To the page: short JSON texts (``welcome``, ``alive``, ``bye``, ``refused``), and one binary message a frame. That is the
length of a JSON header as 4 bytes, least significant first, the header, and then drive levels row by row: those of the
axis or of the image, and those of each patch in turn.

From the page: JSON texts only, ``hello``, ``report``, ``ack`` and ``misfit``; each carries what the page sees of itself.
"""

import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.errors import DeviceError, DeviceProtocolError
from drivers.protocols import Frame

LONGEST_PAGE_ID = 64
LONGEST_TEXT = 200
# Pinch zoom is a float that a touch may leave a hair beside 1.
ZOOM_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class PageReport:
    """What the page sees of itself. ``refresh_hz`` is 0 while it is not measured yet."""

    columns: int
    rows: int
    pixel_ratio: float
    zoom: float
    visible: bool
    fullscreen: bool
    secure: bool
    wake_lock: bool
    refresh_hz: float
    browser: str


@dataclass(frozen=True, slots=True)
class PageMessage:
    """One message of the page. ``run`` and ``seq`` name the frame of an ``ack`` or ``misfit``."""

    kind: str
    report: PageReport
    page_id: str = ""
    run: str = ""
    seq: int = -1


def check_frame(frame: Frame, *, columns: int, rows: int) -> None:
    """Raise ``DeviceProtocolError`` for a frame that does not fit a panel of this many device pixels."""
    panel = f"the page has {columns} × {rows} device pixels"
    arrays = [array for array in (frame.levels, frame.image) if array is not None]
    for array in (*arrays, *(patch.levels for patch in frame.patches)):
        if array.dtype != np.uint8:
            raise DeviceProtocolError(f"display: levels of type {array.dtype} asked; drive levels are uint8")
    if frame.image is not None:
        if frame.axis is not None or frame.levels is not None:
            raise DeviceProtocolError("display: a frame is an image or levels along an axis, this one is both")
        if frame.image.shape != (rows, columns):
            raise DeviceProtocolError(f"display: an image of shape {frame.image.shape} asked, {panel}")
    elif frame.axis is None or frame.levels is None:
        raise DeviceProtocolError("display: a frame needs an image, or levels and their axis; this one is empty")
    elif frame.levels.shape != ((columns if frame.axis == "x" else rows),):
        raise DeviceProtocolError(f"display: {frame.levels.size} levels along {frame.axis} asked, {panel}")
    for patch in frame.patches:
        height, width = patch.levels.shape
        if not (0 <= patch.row <= rows - height and 0 <= patch.column <= columns - width):
            raise DeviceProtocolError(
                f"display: a patch of {width} × {height} at column {patch.column}, row {patch.row} asked, {panel}"
            )


def encode_frame(frame: Frame, *, columns: int, rows: int, run: str, seq: int, frame_id: int) -> bytes:
    """Return the binary message that shows ``frame`` on a canvas of exactly ``columns`` × ``rows`` device pixels."""
    under = frame.image if frame.image is not None else frame.levels
    if under is None:
        raise DeviceProtocolError("display: a frame needs an image, or levels and their axis; this one is empty")
    header = {
        "run": run,
        "seq": seq,
        "frame_id": frame_id,
        "columns": columns,
        "rows": rows,
        "axis": frame.axis,
        "patches": [[p.column, p.row, p.levels.shape[1], p.levels.shape[0]] for p in frame.patches],
    }
    text = json.dumps(header).encode()
    levels = [np.ascontiguousarray(array).tobytes() for array in (under, *(p.levels for p in frame.patches))]
    return b"".join([len(text).to_bytes(4, "little"), text, *levels])


def decode_page_message(text: str) -> PageMessage:
    """Read a message of the page; anything that the page does not say is a ``DeviceProtocolError``."""
    try:
        data = json.loads(text)
        kind = data["type"]
        if kind not in ("hello", "report", "ack", "misfit"):
            raise ValueError(f"unknown type {kind!r:.40}")
        report = _report(data["report"])
        if kind == "hello":
            return PageMessage(kind, report, page_id=_text(data["page_id"], LONGEST_PAGE_ID))
        if kind == "report":
            return PageMessage(kind, report)
        return PageMessage(kind, report, run=_text(data["run"], LONGEST_PAGE_ID), seq=_whole(data["seq"]))
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise DeviceProtocolError(f"display: the page said something unexpected ({error}); reload it") from None


def page_fault(report: PageReport, *, columns: int, rows: int, pixel_ratio: float) -> str | None:
    """Say what is wrong with the page and what to do, or None while it is as it was at the first frame."""
    if not report.visible:
        return "the page is hidden or the tablet sleeps; wake it and bring the page to the front"
    if abs(report.zoom - 1) > ZOOM_TOLERANCE:
        return f"the page is zoomed in by {report.zoom:.2f}; pinch it back to full size"
    was, now = (columns, rows), (report.columns, report.rows)
    if now == was[::-1] and now != was:
        return (
            f"the tablet was rotated: the page has {now[0]} × {now[1]} device pixels, it had {was[0]} × {was[1]}; "
            "turn it back and lock its rotation"
        )
    if now != was:
        return (
            f"the page has {now[0]} × {now[1]} device pixels, it had {was[0]} × {was[1]}; "
            "undo the change of window, zoom or full screen"
        )
    if report.pixel_ratio != pixel_ratio:
        return (
            f"the page's device pixel ratio is {report.pixel_ratio:g}, it was {pixel_ratio:g}; "
            "set the browser's zoom back"
        )
    return None


def check_page(report: PageReport, *, columns: int, rows: int, pixel_ratio: float) -> None:
    """Raise ``DeviceError`` when the page is not as it was at the first frame."""
    fault = page_fault(report, columns=columns, rows=rows, pixel_ratio=pixel_ratio)
    if fault is not None:
        raise DeviceError(f"display: {fault}")


def _report(data: dict[str, Any]) -> PageReport:
    return PageReport(
        columns=_whole(data["columns"]),
        rows=_whole(data["rows"]),
        pixel_ratio=_number(data["ratio"]),
        zoom=_number(data["zoom"]),
        visible=data["visible"] is True,
        fullscreen=data["fullscreen"] is True,
        secure=data["secure"] is True,
        wake_lock=data["wake_lock"] is True,
        refresh_hz=_number(data["refresh_hz"]),
        browser=_text(data["browser"], LONGEST_TEXT),
    )


def _whole(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**53:
        raise ValueError(f"a whole number expected, found {value!r:.40}")
    return value


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
        raise ValueError(f"a number expected, found {value!r:.40}")
    return float(value)


def _text(value: object, longest: int) -> str:
    if not isinstance(value, str) or len(value) > longest:
        raise ValueError(f"a text of at most {longest} letters expected")
    return value
