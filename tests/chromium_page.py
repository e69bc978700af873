"""Pages in headless Chromium, driven over its remote debugging protocol: load, look at the screen, resize, ask.

One browser serves many pages; each page has a context of its own, as if it were another person's browser.
"""

import asyncio
import base64
import itertools
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import aiohttp
import cv2
import numpy as np
import pytest

OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--ignore-certificate-errors",
    "--remote-debugging-port=0",
)
ANSWER_TIMEOUT_S = 20.0


class Browser:
    """A running Chromium. Its calls block; what it says unasked is dropped."""

    def __init__(self, folder: Path, *options: str) -> None:
        program = shutil.which("chromium") or shutil.which("chromium-browser")
        if program is None:
            pytest.skip("needs Chromium to show the display's page: apt-get install chromium")
        self._process = subprocess.Popen(
            [program, *OPTIONS, *options, f"--user-data-dir={folder}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._loop = asyncio.new_event_loop()
        self._numbers = itertools.count(1)
        self._run(self._connect(folder / "DevToolsActivePort"))

    def _run(self, work: Any) -> Any:
        return self._loop.run_until_complete(asyncio.wait_for(work, ANSWER_TIMEOUT_S))

    async def _connect(self, port_file: Path) -> None:
        while not (port_file.exists() and len(port_file.read_text().splitlines()) == 2):
            await asyncio.sleep(0.05)
        port, path = port_file.read_text().splitlines()
        self._session = aiohttp.ClientSession()
        self._socket = await self._session.ws_connect(f"ws://127.0.0.1:{port}{path}", max_msg_size=0)

    def call(self, method: str, session: str = "", **parameters: object) -> dict[str, Any]:
        return self._run(self._call(method, session, parameters))

    async def _call(self, method: str, session: str, parameters: dict[str, object]) -> dict[str, Any]:
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters} | ({"sessionId": session} if session else {})
        await self._socket.send_json(message)
        while True:
            answer = await self._socket.receive_json()
            if answer.get("id") == number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]

    @contextmanager
    def page(self, url: str, *, columns: int, rows: int, ratio: float = 1.0) -> Iterator["Page"]:
        """Open a page on a screen of ``columns`` × ``rows`` device pixels."""
        context = self.call("Target.createBrowserContext")["browserContextId"]
        target = self.call(
            "Target.createTarget", url="about:blank", browserContextId=context, newWindow=True, width=800, height=600
        )["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = Page(self, session, context)
        try:
            page.resize(columns=columns, rows=rows, ratio=ratio)
            page.go_to(url)
            yield page
        finally:
            self.call("Target.disposeBrowserContext", browserContextId=context)

    def close(self) -> None:
        self._run(self._socket.close())
        self._run(self._session.close())
        self._run(asyncio.sleep(0.1))  # closing a connection takes a turn of the loop
        self._loop.close()
        self._process.terminate()
        self._process.wait(timeout=30)


class Page:
    """One page."""

    def __init__(self, browser: Browser, session: str, context: str) -> None:
        self._browser = browser
        self._session = session
        self.context = context
        self.own_ratio = float(self.ask("devicePixelRatio"))

    def call(self, method: str, **parameters: object) -> dict[str, Any]:
        return self._browser.call(method, self._session, **parameters)

    def go_to(self, url: str) -> None:
        self.call("Page.navigate", url=url)

    def resize(self, *, columns: int, rows: int, ratio: float = 1.0) -> None:
        """Give the page a screen of ``columns`` × ``rows`` device pixels; ``ratio=0`` keeps the browser's own ratio."""
        width, height = round(columns / (ratio or self.own_ratio)), round(rows / (ratio or self.own_ratio))
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=ratio, mobile=False
        )

    def hide(self) -> None:
        """Put another tab before it."""
        self._browser.call("Target.createTarget", url="about:blank", browserContextId=self.context)

    def bring_back(self) -> None:
        self.call("Page.bringToFront")

    def ask(self, expression: str) -> Any:
        """Return what a JavaScript expression is on the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait_until(self, expression: str, *, timeout_s: float = 30.0) -> None:
        deadline_s = time.monotonic() + timeout_s
        while not self.ask(expression):
            assert time.monotonic() < deadline_s, f"never came true: {expression}"
            time.sleep(0.02)

    def picture(self) -> np.ndarray:
        """Return what is on the screen, [rows, columns, red green blue]."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        return picture[..., ::-1]


@contextmanager
def open_browser(*options: str) -> Iterator[Browser]:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        browser = Browser(Path(folder), *options)
        try:
            yield browser
        finally:
            browser.close()
