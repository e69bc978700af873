"""The stripe player with a page in Chromium, and a world that looks at the browser's screen."""

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from chromium_page import Browser, Page, open_browser

from drivers.protocols import Display, Frame, Patch
from drivers.stripe_player import StripePlayer
from drivers.stripe_player.address import parse_address

_shared = ExitStack()
_browsers: list[Browser] = []


def shared_browser() -> Browser:
    """Return the one browser of all these tests; :func:`close_browser` ends it."""
    if not _browsers:
        _browsers.append(_shared.enter_context(open_browser()))
    return _browsers[0]


def close_browser() -> None:
    _browsers.clear()
    _shared.close()


@dataclass(frozen=True)
class ScreenSight:
    frame: Frame
    frame_id: int


class BrowserScreen:
    """What a person sees who looks at the browser's screen, told in the words of a frame."""

    def __init__(self, page: Page) -> None:
        self._page = page

    def look(self) -> ScreenSight:
        picture = self._page.picture()
        assert (picture == picture[..., :1]).all(), "a white primary gives grey levels"
        levels = picture[..., 0]
        frame_id = int(self._page.ask("canvas.dataset.frame"))
        frames = [_as_frame(levels, "x"), _as_frame(levels, "y")]
        return ScreenSight(min(frames, key=lambda frame: sum(patch.levels.size for patch in frame.patches)), frame_id)


def _as_frame(levels: np.ndarray, axis: str) -> Frame:
    """Read a picture as levels along ``axis``, and one patch around whatever differs from that."""
    along = 0 if axis == "x" else 1
    under = np.median(levels, axis=along).astype(np.uint8)
    other = np.argwhere(levels != np.expand_dims(under, along))
    patches = []
    if len(other):
        (top, left), (bottom, right) = other.min(axis=0), other.max(axis=0) + 1
        patches.append(Patch(int(left), int(top), levels[top:bottom, left:right]))
    return Frame(axis="x" if axis == "x" else "y", levels=under, patches=tuple(patches))


@contextmanager
def stripe_player_in_chromium(columns: int, rows: int) -> Iterator[tuple[Display, BrowserScreen]]:
    """Yield the player and its screen; the page outlives the player's exit, so that one can look afterwards."""
    browser = shared_browser()
    with tempfile.TemporaryDirectory() as folder:
        player = StripePlayer(
            parse_address("127.0.0.1:0"),
            primary="white",
            state_folder=Path(folder),
            announce=print,
            page_timeout_s=30.0,
        )
        player.__enter__()
        pages = ExitStack()
        try:
            page = pages.enter_context(browser.page(player.url(), columns=columns, rows=rows))
            player.screen()
            yield player, BrowserScreen(page)
        finally:
            player.__exit__(None, None, None)
            _left_open.append(pages)


_left_open: list[ExitStack] = []


def close_pages() -> None:
    """Close the pages that were left open to be looked at."""
    while _left_open:
        _left_open.pop().close()
