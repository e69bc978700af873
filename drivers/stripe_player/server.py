"""Serves the page and its socket to one browser of the local network, on a thread and an event loop of its own.

Whoever calls needs the token, a private address, and for the socket the page's own origin. Three addresses exist: the page,
its socket, and the certificate. No file is looked up by a name that a caller gives.
"""

import asyncio
import base64
import hashlib
import hmac
import json
import logging
import os
import re
import ssl
import threading
from collections.abc import Awaitable, Callable
from dataclasses import replace
from importlib import resources

from aiohttp import WSCloseCode, WSMsgType, web

from drivers.errors import DeviceBusyError, DeviceNotFoundError, DeviceProtocolError
from drivers.stripe_player.address import PageAddress, is_local
from drivers.stripe_player.mailbox import Mailbox
from drivers.stripe_player.wire import PageMessage, decode_page_message

LARGEST_MESSAGE_BYTES = 16 * 1024
ALIVE_EVERY_S = 2.0
# A tablet that fell asleep or left the network is noticed after about one and a half of these.
HEARTBEAT_S = 5.0
HELLO_TIMEOUT_S = 10.0
FAREWELL_S = 1.0
START_TIMEOUT_S = 20.0
REPLACED, REFUSED = 4001, 4003
SECOND_SCREEN = "Another screen is already connected to the rig. Close the page there; this one then goes on by itself."
MOVED = "This page went on in another tab."

logger = logging.getLogger(__name__)
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class PageServer:
    """The server, from ``start`` to ``stop``. ``primary`` is the colour that drive levels light."""

    def __init__(
        self,
        mailbox: Mailbox,
        address: PageAddress,
        *,
        token: str,
        primary: str,
        tls: ssl.SSLContext | None = None,
        certificate: bytes = b"",
    ) -> None:
        self.address = address
        self._mailbox = mailbox
        self._token = token
        self._primary = primary
        self._tls = tls
        self._certificate = certificate
        self._page = resources.files("drivers.stripe_player").joinpath("page.html").read_text("utf-8")
        self._client: web.WebSocketResponse | None = None
        self._client_page_id = ""
        self._farewells: set[asyncio.Task[None]] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._started = threading.Event()
        self._failure: OSError | None = None

    # The rig's thread

    def start(self) -> None:
        """Begin to listen; returns when the port is open, and ``address`` then holds the port that was given."""
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name="stripe player", daemon=True)
        self._thread.start()
        if not self._started.wait(START_TIMEOUT_S):
            raise DeviceNotFoundError(f"display: the page's server did not start within {START_TIMEOUT_S:g} s")
        if self._failure is not None:
            self._thread.join()
            raise DeviceBusyError(
                f"display: cannot listen at {self.address.netloc()} ({os.strerror(self._failure.errno or 0)}); is another "
                "rig command running? Else choose another port, or the address that this machine has now"
            )

    def push(self) -> None:
        """Send the mailbox's frame to the page, if one is connected; it gets it on connecting otherwise."""
        if self._loop is not None:
            asyncio.run_coroutine_threadsafe(self._push(), self._loop)

    def stop(self) -> None:
        """Close the connection and the port; any time, twice."""
        if self._thread is not None and self._thread.is_alive() and self._loop is not None:
            self._loop.call_soon_threadsafe(self._stopped.set)
            self._thread.join()

    # The server's own thread

    async def _serve(self) -> None:
        self._stopped = asyncio.Event()
        self._loop = asyncio.get_running_loop()

        @web.middleware
        async def guard(request: web.Request, handler: Handler) -> web.StreamResponse:
            self._check(request)
            return await handler(request)

        application = web.Application(middlewares=[guard], client_max_size=LARGEST_MESSAGE_BYTES)
        application.add_routes([web.get("/", self._give_page), web.get("/socket", self._talk)])
        if self._certificate:
            application.add_routes([web.get("/certificate.crt", self._give_certificate)])
        runner = web.AppRunner(application, access_log=None, handle_signals=False, shutdown_timeout=1.0)
        await runner.setup()
        try:
            site = web.TCPSite(runner, self.address.host, self.address.port, ssl_context=self._tls)
            await site.start()
            self.address = replace(self.address, port=int(runner.addresses[0][1]))
            self._started.set()
            await self._stopped.wait()
            if self._client is not None:
                await self._client.close(code=WSCloseCode.GOING_AWAY, message=b"the rig has finished")
        except OSError as error:
            self._failure = error
        finally:
            await _clean_up(runner)
            self._started.set()

    def _check(self, request: web.Request) -> None:
        """Refuse strangers in one sentence, before anything else looks at the request."""
        if not is_local(request.remote or ""):
            raise web.HTTPForbidden(text="The rig answers only to its own network.")
        # A name that some other site pointed at this machine would let that site's pages in.
        if request.host != self.address.netloc():
            raise web.HTTPForbidden(text=f"The rig's page is at {self.address.origin()}, not at {request.host[:80]}.")
        if request.path != "/certificate.crt" and not hmac.compare_digest(
            request.query.get("token", "").encode(), self._token.encode()
        ):
            raise web.HTTPForbidden(text="This address lacks the rig's token; scan the QR code that the rig prints.")

    async def _give_page(self, request: web.Request) -> web.Response:  # noqa: ARG002  (one page for all)
        headers = {
            "Content-Security-Policy": content_security_policy(self._page, self.address),
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
        }
        return web.Response(text=self._page, content_type="text/html", headers=headers)

    async def _give_certificate(self, request: web.Request) -> web.Response:  # noqa: ARG002  (it is no secret)
        return web.Response(body=self._certificate, content_type="application/x-x509-ca-cert")

    async def _talk(self, request: web.Request) -> web.StreamResponse:
        if request.headers.get("Origin") != self.address.origin():
            raise web.HTTPForbidden(text="Only the rig's own page may connect.")
        socket = web.WebSocketResponse(
            heartbeat=HEARTBEAT_S, timeout=FAREWELL_S, max_msg_size=LARGEST_MESSAGE_BYTES, compress=False
        )
        await socket.prepare(request)
        try:
            hello = decode_page_message(await socket.receive_str(timeout=HELLO_TIMEOUT_S))
            if hello.kind != "hello":
                raise DeviceProtocolError("display: the page did not introduce itself; reload it")
            if await self._admit(socket, hello):
                await self._listen(socket, hello)
        except (DeviceProtocolError, TypeError, TimeoutError) as error:
            # TypeError is how aiohttp says that the message was no text.
            logger.warning("%s", error or "display: the page did not introduce itself in time")
            await socket.close(code=WSCloseCode.POLICY_VIOLATION)
        except ConnectionError:
            logger.info("display: the page went away")
        return socket

    async def _admit(self, socket: web.WebSocketResponse, hello: PageMessage) -> bool:
        """Let one page in. The same page coming back takes its own place, even if its old line is not known dead yet."""
        before = self._client
        if before is not None and hello.page_id != self._client_page_id:
            await _dismiss(socket, REFUSED, SECOND_SCREEN)
            return False
        self._client, self._client_page_id = socket, hello.page_id
        if before is not None:
            # Not waited for: a line that is dead does not answer a farewell.
            farewell = asyncio.create_task(_dismiss(before, REPLACED, MOVED))
            self._farewells.add(farewell)
            farewell.add_done_callback(self._farewells.discard)
        return True

    async def _listen(self, socket: web.WebSocketResponse, hello: PageMessage) -> None:
        alive: asyncio.Task[None] | None = None
        try:
            await socket.send_json({"type": "welcome", "run": self._mailbox.run, "primary": self._primary})
            self._mailbox.take(hello)
            await self._push()
            alive = asyncio.create_task(_say_alive(socket))
            async for message in socket:
                if message.type != WSMsgType.TEXT:
                    raise DeviceProtocolError("display: the page sent something that is no text; reload it")
                said = decode_page_message(message.data)
                if self._client is socket:
                    self._mailbox.take(said)
        finally:
            if alive is not None:
                alive.cancel()
            if self._client is socket:
                self._client = None
                self._mailbox.page_is_gone()

    async def _push(self) -> None:
        message, client = self._mailbox.message(), self._client
        if message is None or client is None:
            return
        try:
            await client.send_bytes(message)
        except (ConnectionError, RuntimeError):
            logger.info("display: the page went away before it got its frame")


async def _clean_up(runner: web.AppRunner) -> None:
    """Close the port and every line, without waiting for a browser to agree to the end of its TLS."""
    lines = [] if runner.server is None else [handler.transport for handler in runner.server.connections]
    # Before the clean-up: it closes each line once more, and Python 3.11.2 cannot abort a TLS line closed twice.
    for line in lines:
        if line is not None:
            line.abort()
    await runner.cleanup()
    # Closing takes a turn of the loop.
    await asyncio.sleep(0)


async def _dismiss(socket: web.WebSocketResponse, code: int, reason: str) -> None:
    try:
        await socket.send_str(json.dumps({"type": "refused", "reason": reason}))
        await socket.close(code=code, message=reason.encode()[:120])
    except (ConnectionError, RuntimeError):
        logger.info("display: a page went away by itself")


async def _say_alive(socket: web.WebSocketResponse) -> None:
    try:
        while True:
            await asyncio.sleep(ALIVE_EVERY_S)
            await socket.send_str('{"type":"alive"}')
    except (ConnectionError, RuntimeError):
        logger.info("display: the page went away")


def content_security_policy(page: str, address: PageAddress) -> str:
    """Return the policy under which the page runs: its own script and style, its own server, nothing else."""

    def hashes(tag: str) -> str:
        found = re.findall(rf"<{tag}>(.*?)</{tag}>", page, flags=re.DOTALL)
        return " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(t.encode()).digest()).decode()}'" for t in found)

    # Older Safari does not count the socket as 'self'.
    socket = f"{'wss' if address.secure else 'ws'}://{address.netloc()}"
    return (
        f"default-src 'none'; script-src {hashes('script')}; style-src {hashes('style')}; img-src data:; "
        f"connect-src 'self' {socket}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
