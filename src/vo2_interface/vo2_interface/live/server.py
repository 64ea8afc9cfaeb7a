"""The page's server: this host only, the standard library only, one thread per open page."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from vo2_interface.live.frames import Frames

__all__ = ["BUTTONS", "FRAMES_PER_S", "LiveServer"]

BUTTONS = ("stop", "release", "activate", "deactivate")
FRAMES_PER_S = 30
_PAGE = Path(__file__).with_name("page.html")
_HOSTS = ("127.0.0.1", "localhost")


class LiveServer:
    """Serves the page on 127.0.0.1 in threads of its own.

    Parameters
    ----------
    frames : what the page shows
    device : what the page must know of the device, as JSON takes it
    press : called with the name of a button, one of `BUTTONS`; returns whether there was somebody to do it
    port : 0 for any that is free

    Attributes
    ----------
    port : the one taken

    Raises
    ------
    OSError : the port is taken.
    """

    def __init__(
        self, frames: Frames, device: Mapping[str, Any], press: Callable[[str], bool], port: int
    ) -> None:
        self._closing = threading.Event()
        self._server = ThreadingHTTPServer(
            ("127.0.0.1", port), _handler(frames, dict(device), press, self._closing)
        )
        self._server.daemon_threads = True
        self.port = int(self._server.server_address[1])
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        """End all streams and free the port."""
        self._closing.set()
        self._server.shutdown()
        self._server.server_close()


def _handler(
    frames: Frames, device: dict[str, Any], press: Callable[[str], bool], closing: threading.Event
) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if not self._is_from_here():
                self.send_error(HTTPStatus.FORBIDDEN)
            elif self.path == "/":
                self._send("text/html; charset=utf-8", _PAGE.read_bytes())
            elif self.path == "/device":
                self._send("application/json", json.dumps(device).encode())
            elif self.path == "/frames":
                self._stream()
            else:
                self.send_error(HTTPStatus.NOT_FOUND)

        def do_POST(self) -> None:
            # a page of another origin cannot set this header without being asked first, and we never allow it
            if not self._is_from_here() or self.headers.get("X-VO2-Live") != "1":
                return self.send_error(HTTPStatus.FORBIDDEN)
            if self.path[1:] not in BUTTONS:
                return self.send_error(HTTPStatus.NOT_FOUND)
            if not press(self.path[1:]):
                return self.send_error(HTTPStatus.SERVICE_UNAVAILABLE)
            self._send("text/plain", b"done")

        def _is_from_here(self) -> bool:
            """Whether we were asked by this host's own name: by another one a foreign page could reach us."""
            return self.headers.get("Host", "").rsplit(":", 1)[0] in _HOSTS

        def _send(self, kind: str, body: bytes) -> None:
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header(
                "Content-Security-Policy", "default-src 'self' 'unsafe-inline'; frame-ancestors 'none'"
            )
            self.end_headers()
            self.wfile.write(body)

        def _stream(self) -> None:
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            count, due = 0, time.monotonic()
            try:
                while not closing.is_set():
                    count, line = frames.since(count)
                    self.wfile.write(f"data: {line}\n\n".encode())
                    due = max(due + 1.0 / FRAMES_PER_S, time.monotonic())
                    closing.wait(due - time.monotonic())
            except (BrokenPipeError, ConnectionResetError):
                return  # the page was closed

        def log_message(self, format: str, *args: Any) -> None:
            """Write nothing: one line a request would bury the node's own."""

    return Handler
