"""The stripe player against Chromium: what is commanded is on the screen, pixel by pixel, or the rig hears why not."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from chromium_page import Browser, Page, open_browser
from faults_page import OperatorReads

from drivers.errors import DeviceError, DeviceNotFoundError, DeviceTimeoutError
from drivers.protocols import Frame, Patch
from drivers.stripe_player import StripePlayer
from drivers.stripe_player.address import parse_address

COLUMNS, ROWS = 200, 120
TIMEOUT_S = 30.0


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with open_browser() as opened:
        yield opened


@contextmanager
def player(folder: Path, address: str = "127.0.0.1:0", *, primary: str = "white") -> Iterator[StripePlayer]:
    announced: list[str] = []
    with StripePlayer(
        parse_address(address),
        primary=primary,
        state_folder=folder,
        announce=announced.append,
        page_timeout_s=TIMEOUT_S,
    ) as opened:
        yield opened


@contextmanager
def playing(browser: Browser, folder: Path, **changes: object) -> Iterator[tuple[StripePlayer, Page]]:
    """A player and its page, with the page open until the player has left."""
    screen = {"columns": COLUMNS, "rows": ROWS, "ratio": 1.0} | changes
    primary = str(screen.pop("primary", "white"))
    url: list[str] = []
    opener = player(folder, primary=primary)
    device = opener.__enter__()
    url.append(device.url())
    with browser.page(url[0], **screen) as page:  # type: ignore[arg-type]
        try:
            device.screen()
            yield device, page
        finally:
            opener.__exit__(None, None, None)


def stripe(place: int, count: int = COLUMNS, level: int = 255) -> np.ndarray:
    levels = np.zeros(count, np.uint8)
    levels[place] = level
    return levels


def raised_cosine(count: int, *, centre: float, width: float) -> np.ndarray:
    distance = np.abs(np.arange(count) - centre)
    return np.where(distance < width / 2, np.round(127.5 * (1 + np.cos(2 * np.pi * distance / width))), 0).astype(
        np.uint8
    )


def eventually(happens: Callable[[], bool]) -> bool:
    deadline_s = time.monotonic() + TIMEOUT_S
    while not happens() and time.monotonic() < deadline_s:
        time.sleep(0.02)
    return happens()


def frames_to_try(columns: int, rows: int) -> list[tuple[Frame, np.ndarray]]:
    """Frames, and the drive level that each device pixel must have.

    Along each axis a line of one device pixel at both ends and beside them, and a raised cosine that begins before the first
    pixel, one that ends behind the last, and one between pixels.
    """
    tried = []
    for axis, count, across in (("x", columns, (rows, 1)), ("y", rows, (columns, 1))):
        lines = [stripe(place, count) for place in (0, 1, count - 2, count - 1)]
        centres = (2.0, count / 3 + 0.25, count - 3.0)
        for levels in (*lines, *(raised_cosine(count, centre=centre, width=24) for centre in centres)):
            wanted = np.tile(levels, across)
            tried.append((Frame(axis=axis, levels=levels), wanted if axis == "x" else wanted.T))
    image = np.random.default_rng(5).integers(0, 256, (rows, columns), dtype=np.uint8)
    under = image.copy()
    under[-4:, -6:] = 77
    tried.append((Frame(image=image, patches=(Patch(columns - 6, rows - 4, np.full((4, 6), 77, np.uint8)),)), under))
    return tried


@pytest.mark.parametrize(
    ("primary", "channels", "ratio"),
    [
        ("white", (0, 1, 2), 1.0),
        ("green", (1,), 1.0),
        ("white", (0, 1, 2), 1.5),
        ("white", (0, 1, 2), 2.0),
        ("green", (1,), 2.0),
        ("red", (0,), 1.5),
        ("blue", (2,), 1.5),
    ],
)
def test_every_device_pixel_is_as_commanded(
    browser: Browser, tmp_path: Path, primary: str, channels: tuple[int, ...], ratio: float
) -> None:
    columns, rows = 240, 180
    with playing(browser, tmp_path, columns=columns, rows=rows, ratio=ratio, primary=primary) as (device, page):
        seen = device.screen()
        assert (seen.columns, seen.rows, seen.pixel_ratio) == (columns, rows, ratio)
        for number, (frame, levels) in enumerate(frames_to_try(columns, rows)):
            device.show(frame, frame_id=number, timeout_s=TIMEOUT_S)
            wanted = np.zeros((rows, columns, 3), np.uint8)
            wanted[..., list(channels)] = levels[..., None]
            np.testing.assert_array_equal(page.picture(), wanted)


@pytest.mark.parametrize(("ratio", "columns", "rows"), [(1.0, 1280, 800), (1.5, 1536, 1152), (2.0, 2048, 1536)])
def test_a_whole_tablet_at_its_own_ratio_is_exact(tmp_path: Path, ratio: float, columns: int, rows: int) -> None:
    with (
        open_browser(f"--force-device-scale-factor={ratio}") as browser,
        playing(browser, tmp_path, columns=columns, rows=rows, ratio=0.0, primary="green") as (device, page),
    ):
        seen = device.screen()
        assert (seen.columns, seen.rows, seen.pixel_ratio) == (columns, rows, ratio)
        for number, (frame, levels) in enumerate(frames_to_try(columns, rows)):
            device.show(frame, frame_id=number, timeout_s=TIMEOUT_S)
            picture = page.picture()
            np.testing.assert_array_equal(picture[..., 1], levels)
            assert not picture[..., [0, 2]].any()


def test_leaving_makes_the_glass_dark(browser: Browser, tmp_path: Path) -> None:
    with playing(browser, tmp_path) as (device, page):
        device.show(Frame(axis="x", levels=np.full(COLUMNS, 255, np.uint8)), frame_id=1, timeout_s=TIMEOUT_S)
        assert page.picture().min() == 255
        device.__exit__(None, None, None)
        assert not page.picture().any()


def test_forty_frames_are_each_on_the_glass_when_show_returns(browser: Browser, tmp_path: Path) -> None:
    with playing(browser, tmp_path) as (device, page):
        begin_s = time.monotonic()
        for number in range(40):
            device.show(Frame(axis="x", levels=stripe(number)), frame_id=number, timeout_s=TIMEOUT_S)
            assert page.ask("canvas.dataset.frame") == str(number)
        # Three refreshes a frame after the one that draws it: faster than 60 Hz allows would be a lie.
        assert time.monotonic() - begin_s > 40 * 3 / 60 * 0.9


def test_a_page_that_lost_its_line_comes_back_and_gets_the_frame_of_now(browser: Browser, tmp_path: Path) -> None:
    with playing(browser, tmp_path) as (device, page):
        device.show(Frame(axis="x", levels=stripe(3)), frame_id=3, timeout_s=TIMEOUT_S)
        before = int(page.ask("canvas.dataset.seq"))
        page.ask("socket.close()")
        device.show(Frame(axis="x", levels=stripe(4)), frame_id=4, timeout_s=TIMEOUT_S)
        assert int(page.ask("canvas.dataset.seq")) == before + 1
        np.testing.assert_array_equal(page.picture()[0, :, 0], stripe(4))
        page.call("Page.reload")
        device.show(Frame(axis="x", levels=stripe(5)), frame_id=5, timeout_s=TIMEOUT_S)
        np.testing.assert_array_equal(page.picture()[0, :, 0], stripe(5))


def test_a_reloaded_page_shows_the_frame_again_without_being_asked(browser: Browser, tmp_path: Path) -> None:
    with playing(browser, tmp_path) as (device, page):
        device.show(Frame(axis="x", levels=stripe(3)), frame_id=3, timeout_s=TIMEOUT_S)
        page.call("Page.reload")
        page.wait_until("typeof canvas !== 'undefined' && canvas.dataset.frame === '3'")
        assert eventually(lambda: bool((page.picture()[0, :, 0] == stripe(3)).all()))


def test_the_next_command_finds_the_page_that_is_still_open(browser: Browser, tmp_path: Path) -> None:
    with playing(browser, tmp_path) as (device, page):
        device.show(Frame(axis="x", levels=stripe(3)), frame_id=3, timeout_s=TIMEOUT_S)
        address = device.info().address.removeprefix("http://")
        device.__exit__(None, None, None)
        with player(tmp_path, address) as following:
            following.screen()
            following.show(Frame(axis="x", levels=stripe(9)), frame_id=9, timeout_s=TIMEOUT_S)
            np.testing.assert_array_equal(page.picture()[0, :, 0], stripe(9))


def test_a_rotated_tablet_suspends_the_run_and_turning_it_back_lets_it_go_on(
    operator_reads: OperatorReads, browser: Browser, tmp_path: Path
) -> None:
    with playing(browser, tmp_path) as (device, page):
        device.show(Frame(axis="x", levels=stripe(3)), frame_id=3, timeout_s=TIMEOUT_S)
        page.resize(columns=ROWS, rows=COLUMNS)
        page.wait_until(f"canvas.width === {ROWS}")
        with operator_reads.raised(DeviceError):
            device.show(Frame(axis="x", levels=stripe(4)), frame_id=4, timeout_s=TIMEOUT_S)
        page.resize(columns=COLUMNS, rows=ROWS)
        assert eventually(lambda: device.screen().columns == COLUMNS)
        device.show(Frame(axis="x", levels=stripe(4)), frame_id=4, timeout_s=TIMEOUT_S)
        np.testing.assert_array_equal(page.picture()[0, :, 0], stripe(4))


@pytest.mark.parametrize(
    "change",
    [
        {"columns": COLUMNS - 20, "rows": ROWS},
        {"columns": COLUMNS, "rows": ROWS, "ratio": 2.0},
    ],
    ids=["size", "ratio"],
)
def test_another_size_or_ratio_suspends_the_run(
    operator_reads: OperatorReads, browser: Browser, tmp_path: Path, change: dict[str, float]
) -> None:
    with playing(browser, tmp_path) as (device, page):
        device.show(Frame(axis="x", levels=stripe(3)), frame_id=3, timeout_s=TIMEOUT_S)
        page.resize(**change)  # type: ignore[arg-type]
        ratio, columns = change.get("ratio", 1.0), change["columns"]
        page.wait_until(f"devicePixelRatio === {ratio} && canvas.width === {columns}")
        assert eventually(lambda: (device.screen().pixel_ratio, device.screen().columns) == (ratio, columns))
        with operator_reads.raised(DeviceError):
            device.show(Frame(axis="x", levels=stripe(4)), frame_id=4, timeout_s=TIMEOUT_S)
        page.resize(columns=COLUMNS, rows=ROWS)
        assert eventually(lambda: (device.screen().pixel_ratio, device.screen().columns) == (1.0, COLUMNS))
        device.show(Frame(axis="x", levels=stripe(4)), frame_id=4, timeout_s=TIMEOUT_S)


def test_a_pinched_page_suspends_the_run(operator_reads: OperatorReads, browser: Browser, tmp_path: Path) -> None:
    with playing(browser, tmp_path) as (device, page):
        device.show(Frame(axis="x", levels=stripe(3)), frame_id=3, timeout_s=TIMEOUT_S)
        page.call("Emulation.setPageScaleFactor", pageScaleFactor=1.5)
        page.wait_until("visualViewport.scale > 1.4")
        with operator_reads.raised(DeviceError):
            device.show(Frame(axis="x", levels=stripe(4)), frame_id=4, timeout_s=TIMEOUT_S)
        page.call("Emulation.setPageScaleFactor", pageScaleFactor=1.0)
        report = device.report
        assert eventually(lambda: (seen := report()) is not None and seen.zoom == 1.0)
        device.show(Frame(axis="x", levels=stripe(4)), frame_id=4, timeout_s=TIMEOUT_S)


def test_a_page_that_goes_to_the_background_suspends_the_run(
    operator_reads: OperatorReads, browser: Browser, tmp_path: Path
) -> None:
    with playing(browser, tmp_path) as (device, page):
        device.show(Frame(axis="x", levels=stripe(3)), frame_id=3, timeout_s=TIMEOUT_S)
        page.hide()
        assert eventually(lambda: not device.screen().visible)
        with operator_reads.raised(DeviceError):
            device.show(Frame(axis="x", levels=stripe(4)), frame_id=4, timeout_s=TIMEOUT_S)
        page.bring_back()
        assert eventually(lambda: device.screen().visible)
        device.show(Frame(axis="x", levels=stripe(4)), frame_id=4, timeout_s=TIMEOUT_S)


def test_hiding_the_page_while_a_frame_is_on_its_way_ends_the_wait_at_once(
    operator_reads: OperatorReads, browser: Browser, tmp_path: Path
) -> None:
    with playing(browser, tmp_path) as (device, page):
        device.show(Frame(axis="x", levels=stripe(3)), frame_id=3, timeout_s=TIMEOUT_S)
        page.ask("window.requestAnimationFrame = () => 0")  # as on a tablet whose screen is off
        found: list[BaseException] = []

        def ask() -> None:
            try:
                device.show(Frame(axis="x", levels=stripe(4)), frame_id=4, timeout_s=10 * TIMEOUT_S)
            except DeviceError as error:
                found.append(error)

        waiting = threading.Thread(target=ask)
        waiting.start()
        page.wait_until("wanted.frame_id === 4")
        page.hide()
        waiting.join(TIMEOUT_S)
        operator_reads(found[0])


def test_a_page_that_never_paints_is_a_timeout_and_not_a_photo(
    operator_reads: OperatorReads, browser: Browser, tmp_path: Path
) -> None:
    with playing(browser, tmp_path) as (device, page):
        device.show(Frame(axis="x", levels=stripe(3)), frame_id=3, timeout_s=TIMEOUT_S)
        page.ask("window.requestAnimationFrame = () => 0")
        with operator_reads.raised(DeviceTimeoutError):
            device.show(Frame(axis="x", levels=stripe(4)), frame_id=4, timeout_s=0.5)


def test_a_frame_without_a_page_says_where_to_open_it(
    operator_reads: OperatorReads, browser: Browser, tmp_path: Path
) -> None:
    with playing(browser, tmp_path) as (device, page):
        device.show(Frame(axis="x", levels=stripe(3)), frame_id=3, timeout_s=TIMEOUT_S)
        page.go_to("about:blank")
        assert eventually(lambda: device.report() is None)
        with operator_reads.raised(DeviceTimeoutError):
            device.show(Frame(axis="x", levels=stripe(4)), frame_id=4, timeout_s=0.2)


def test_a_second_screen_is_refused_in_a_sentence_and_takes_over_when_the_first_has_gone(
    operator_reads: OperatorReads, browser: Browser, tmp_path: Path
) -> None:
    with playing(browser, tmp_path) as (device, first):
        device.show(Frame(axis="x", levels=stripe(3)), frame_id=3, timeout_s=TIMEOUT_S)
        with browser.page(device.url(), columns=COLUMNS, rows=ROWS) as second:
            second.wait_until("document.getElementById('trouble')?.textContent.startsWith('Another screen')")
            operator_reads(second.ask("document.getElementById('trouble').textContent"))
            device.show(Frame(axis="x", levels=stripe(4)), frame_id=4, timeout_s=TIMEOUT_S)
            np.testing.assert_array_equal(first.picture()[0, :, 0], stripe(4))
            assert second.ask("document.body.classList.contains('playing')") is False
            first.go_to("about:blank")
            second.wait_until("canvas.dataset.frame === '4'")


def test_nobody_opening_the_page_is_said_after_the_address_was_announced(
    operator_reads: OperatorReads, tmp_path: Path
) -> None:
    announced: list[str] = []
    with StripePlayer(
        parse_address("127.0.0.1:0"),
        primary="white",
        state_folder=tmp_path,
        announce=announced.append,
        page_timeout_s=4.2,
    ) as device:
        with operator_reads.raised(DeviceNotFoundError):
            device.screen()
        (text,) = announced
        assert device.url() in text
        assert "▄" in text or "█" in text


def test_the_page_over_tls_is_a_secure_context(
    browser: Browser, tmp_path: Path, require_program: Callable[[str, str], str]
) -> None:
    require_program("openssl", "openssl")
    with player(tmp_path, "https://127.0.0.1:0") as device, browser.page(device.url(), columns=COLUMNS, rows=ROWS):
        device.screen()
        report = device.report()
        assert report is not None
        assert report.secure
        assert report.wake_lock
