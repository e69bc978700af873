"""The display that the rig sees: it shows frames on a page, and believes only what the page acknowledges."""

import logging
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Literal

import numpy as np

from drivers.errors import DeviceError, DeviceNotFoundError, DeviceTimeoutError
from drivers.protocols import DeviceInfo, DeviceKind, Frame, ScreenInfo
from drivers.stripe_player.address import PageAddress, keep_token, qr_code
from drivers.stripe_player.certificate import certificate_der, server_context
from drivers.stripe_player.mailbox import Mailbox
from drivers.stripe_player.wire import PageReport, check_frame, check_page

# No screen refreshes faster, and the page acknowledges three refreshes after drawing: no shorter deadline can be met.
FASTEST_REFRESH_HZ = 240.0
REFRESHES_TO_GLASS = 3
# A tablet that is already in the tank comes back within this; only then is the address announced.
RECONNECT_S = 4.0
DARK_TIMEOUT_S = 2.0

logger = logging.getLogger(__name__)


class StripePlayer:
    """Shows frames on a page in a browser. Implements :class:`drivers.protocols.Display`.

    Parameters
    ----------
    address
        Where to serve the page.
    primary
        The colour that drive levels light.
    state_folder
        Where token and certificate are kept from run to run.
    announce
        Called with a text for the operator, the page's address and QR code, when no page connects by itself.
    page_timeout_s
        How long ``screen`` waits for somebody to open the page.
    settle_s
        Extra time between the acknowledgement and the return of ``show``. The rig waits by itself, so it leaves this 0.
    kind
        What the session records: ``"emulated"`` when a program plays the tablet.
    """

    def __init__(
        self,
        address: PageAddress,
        *,
        primary: Literal["white", "red", "green", "blue"],
        state_folder: Path,
        announce: Callable[[str], None],
        page_timeout_s: float,
        settle_s: float = 0.0,
        kind: DeviceKind = "real",
    ) -> None:
        try:
            from drivers.stripe_player.server import PageServer  # here: aiohttp is for a rig with a page only
        except ImportError as error:
            raise DeviceNotFoundError(
                "display: the Python package aiohttp, which serves the page, is not installed; pip install aiohttp"
            ) from error
        self._mailbox = Mailbox()
        self._token = keep_token(state_folder)
        tls = server_context(state_folder, address.host) if address.secure else None
        self._server = PageServer(
            self._mailbox,
            address,
            token=self._token,
            primary=primary,
            tls=tls,
            certificate=certificate_der(state_folder) if tls else b"",
        )
        self._announce = announce
        self._page_timeout_s = page_timeout_s
        self._settle_s = settle_s
        self._kind: DeviceKind = kind
        self._geometry: PageReport | None = None
        self._last: tuple[Frame, int] | None = None

    def url(self) -> str:
        """Return the page's whole address, with its token."""
        return self._server.address.url(self._token)

    def report(self) -> PageReport | None:
        """Return what the page sees of itself now, or None while none is connected: for a doctor."""
        return self._mailbox.report()

    def info(self) -> DeviceInfo:
        """Return the browser that shows the page."""
        report = self._mailbox.report()
        browser = report.browser if report else "no page connected"
        return DeviceInfo(self._kind, "stripe player in a browser", self._server.address.origin(), browser)

    def screen(self) -> ScreenInfo:
        """Return the page's size in device pixels; waits until somebody has opened the page."""
        report = self._wait_for_page()
        if self._last is None:
            self._geometry = report
        return ScreenInfo(report.columns, report.rows, report.pixel_ratio, report.visible)

    def show(self, frame: Frame, *, frame_id: int, timeout_s: float) -> None:
        """Show ``frame``; returns when the page has drawn it and three more refreshes have passed.

        Raises
        ------
        DeviceProtocolError
            The frame does not fit the panel. The last frame stays.
        DeviceError
            The page is not as it was at the first frame: rotated, zoomed, resized, asleep. The next call may succeed.
        DeviceTimeoutError
            No acknowledgement came. The last frame that was acknowledged is put back.
        """
        deadline_s = time.monotonic() + timeout_s
        if self._geometry is None:
            self.screen()
        geometry = self._geometry
        assert geometry is not None  # set by screen()
        columns, rows, ratio = geometry.columns, geometry.rows, geometry.pixel_ratio
        check_frame(frame, columns=columns, rows=rows)
        shortest_s = REFRESHES_TO_GLASS / FASTEST_REFRESH_HZ
        if timeout_s < shortest_s:
            raise DeviceTimeoutError(
                f"display: frame {frame_id} asked within {timeout_s:g} s, no screen can do it in less than "
                f"{shortest_s:g} s; allow more time"
            )
        report = self._mailbox.report()
        if report is not None:
            check_page(report, columns=columns, rows=rows, pixel_ratio=ratio)
        seq = self._mailbox.post(frame, columns=columns, rows=rows, frame_id=frame_id)
        self._server.push()

        def is_on_glass() -> bool:
            seen = self._mailbox.report()
            if seen is not None:
                check_page(seen, columns=columns, rows=rows, pixel_ratio=ratio)
            return self._mailbox.is_acknowledged(seq)

        try:
            if not self._mailbox.wait_for(is_on_glass, deadline_s=deadline_s):
                raise DeviceTimeoutError(self._silence(frame_id, timeout_s))
        except DeviceError:
            self._put_back(geometry)
            raise
        self._last = (frame, frame_id)
        time.sleep(self._settle_s)

    def _silence(self, frame_id: int, timeout_s: float) -> str:
        if self._mailbox.report() is None:
            return (
                f"display: no page is connected, so frame {frame_id} was not on the glass after {timeout_s:g} s; "
                f"open {self._server.address.origin()} with its QR code, check the network"
            )
        return (
            f"display: the page did not confirm frame {frame_id} within {timeout_s:g} s; wake the tablet, "
            "turn off its Low Power Mode, or allow more time"
        )

    def _put_back(self, geometry: PageReport) -> None:
        """Replace a frame that failed by the last good one, so that the glass holds nothing that nobody knows of."""
        columns, rows = geometry.columns, geometry.rows
        frame, frame_id = self._last or (_dark(columns), -1)
        self._mailbox.post(frame, columns=columns, rows=rows, frame_id=frame_id)
        self._server.push()

    def _wait_for_page(self) -> PageReport:
        begin_s = time.monotonic()
        connected = self._mailbox.report() is not None
        for wait_s in (min(RECONNECT_S, self._page_timeout_s), self._page_timeout_s):
            connected = self._mailbox.wait_for(lambda: self._mailbox.report() is not None, deadline_s=begin_s + wait_s)
            if connected or wait_s == self._page_timeout_s:
                break
            self._announce(f"Open this page on the display:\n{self.url()}\n{qr_code(self.url())}")
        report = self._mailbox.report()
        if not connected or report is None:
            raise DeviceNotFoundError(
                f"display: nobody opened {self._server.address.origin()} within {self._page_timeout_s:g} s; scan the "
                "QR code with the tablet, and let both be in the same network"
            )
        return report

    def __enter__(self) -> "StripePlayer":
        self._server.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self._geometry is not None and self._mailbox.report() is not None:
                self.show(_dark(self._geometry.columns), frame_id=-1, timeout_s=DARK_TIMEOUT_S)
        except DeviceError as fault:
            # Leaving must not hide the error that it is left for.
            logger.warning("the display may not be dark: %s", fault)
        finally:
            self._server.stop()


def _dark(columns: int) -> Frame:
    return Frame(axis="x", levels=np.zeros(columns, dtype=np.uint8))
