"""A page on this machine that shows how a capture goes: one HTML file, and its numbers as JSON."""

import json
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from types import TracebackType
from typing import Any, Self

from rig.errors import CaptureError

HOST = "127.0.0.1"


class StatusPage:
    """Serves ``status()`` at ``/status.json`` and a page that shows it at ``/``; port 0 takes any that is free."""

    def __init__(self, status: Callable[[], dict[str, Any]], *, port: int) -> None:
        try:
            self._server = ThreadingHTTPServer((HOST, port), _handler(status))
        except OSError as error:
            raise CaptureError(
                f"status page: port {port} of this machine cannot be used ({error.strerror}); "
                "choose another live.page_port, or 0 for any"
            ) from error
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, name="status page", daemon=True)

    @property
    def address(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self._server.server_address[1]}/"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def _handler(status: Callable[[], dict[str, Any]]) -> type[BaseHTTPRequestHandler]:
    page = (resources.files("rig.live") / "status_page.html").read_bytes()

    class Handler(BaseHTTPRequestHandler):
        """Two addresses, read only."""

        def do_GET(self) -> None:
            """Answer with the page, its numbers, or that there is nothing else."""
            if self.path == "/":
                self._send(200, "text/html; charset=utf-8", page)
            elif self.path == "/status.json":
                self._send(200, "application/json", json.dumps(status(), allow_nan=False).encode())
            else:
                self._send(404, "text/plain", b"nothing here\n")

        def _send(self, code: int, kind: str, body: bytes) -> None:
            self.send_response(code)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *arguments: object) -> None:
            """The terminal belongs to the capture."""

    return Handler
