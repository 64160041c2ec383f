"""A page on which a person draws the box, served on the loopback interface for this one choice.

The address carries a token after ``#``, which browsers do not send. The page exchanges it once for a key that all
further calls need. Requests for another host name (DNS rebinding) or from another origin are refused, the page may load
only its own two files, and the server ends with the choice.
"""

from __future__ import annotations

import json
import math
import secrets
import sys
import threading
import webbrowser
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ...result import Box
from .. import has_screen

PAGES = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
}
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src blob: data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
LARGEST_BODY = 65536  # bytes


def pick_box(frame: npt.NDArray[np.uint8], *, browser: bool = True) -> Box:
    """Let a person draw a box on ``frame`` (H, W, 3) and return it. Blocks until then; KeyboardInterrupt ends it."""
    with PickServer(frame) as server:
        threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
        print(f"draw the box at {server.address}", file=sys.stderr, flush=True)
        if browser and has_screen():
            webbrowser.open(server.address)
        while not server.chosen.wait(0.5):  # short waits, so that Ctrl-C works on all systems
            pass
        server.shutdown()
        assert server.box is not None
        return server.box


class PickServer(ThreadingHTTPServer):
    """Serves one frame to one page. ``chosen`` is set once ``box`` is known."""

    daemon_threads = True

    def __init__(self, frame: npt.NDArray[np.uint8]) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        ok, data = cv2.imencode(".png", frame, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        assert ok
        self.picture, self.height, self.width = data.tobytes(), *frame.shape[:2]
        self.token: str | None = secrets.token_urlsafe(24)
        self.key = secrets.token_urlsafe(24)
        self.lock, self.chosen = threading.Lock(), threading.Event()
        self.box: Box | None = None
        self.host = f"127.0.0.1:{self.server_address[1]}"
        self.address = f"http://{self.host}/#{self.token}"

    def claim(self, token: str) -> str | None:
        """Return the key to the first caller with the token, None to any other."""
        with self.lock:
            if self.token is None or not secrets.compare_digest(token.encode(), self.token.encode()):
                return None
            self.token = None
            return self.key

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore connections that break off."""


class _Handler(BaseHTTPRequestHandler):
    server: PickServer
    server_version, sys_version = "mfcmt", ""
    timeout = 20  # seconds until a silent connection is closed

    def do_GET(self) -> None:
        if not self._admitted():
            return
        if self.path in PAGES:
            name, kind = PAGES[self.path]
            self._answer(HTTPStatus.OK, kind, files(__name__).joinpath(name).read_bytes())
        elif self.path == "/frame" and self._keyed():
            self._answer(HTTPStatus.OK, "image/png", self.server.picture)
        elif self.path != "/frame":
            self._answer(HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        body = self._body()  # read even if refused: closing with unread bytes would drop the answer
        if not self._admitted():
            return
        if "Origin" not in self.headers:
            self._answer(HTTPStatus.FORBIDDEN)
        elif body is None:
            self._answer(HTTPStatus.BAD_REQUEST)
        elif self.path == "/claim":
            key = self.server.claim(str(body.get("token")))
            if key is None:
                self._answer(HTTPStatus.FORBIDDEN)
            else:
                self._answer(HTTPStatus.OK, "application/json", json.dumps({"key": key}).encode())
        elif self.path == "/box":
            if self._keyed():
                self._choose(body.get("box"))
        else:
            self._answer(HTTPStatus.NOT_FOUND)

    def _choose(self, values: Any) -> None:
        numbers = isinstance(values, list) and len(values) == 4 and all(type(v) in (int, float) for v in values)
        if not numbers or not all(math.isfinite(v) for v in values):
            self._answer(HTTPStatus.UNPROCESSABLE_ENTITY)
            return
        x, y, w, h = (float(v) for v in values)
        if w < 1 or h < 1 or x < 0 or y < 0 or x + w > self.server.width or y + h > self.server.height:
            self._answer(HTTPStatus.UNPROCESSABLE_ENTITY)
            return
        self._answer(HTTPStatus.NO_CONTENT)
        with self.server.lock:
            self.server.box = self.server.box or (x, y, w, h)
        self.server.chosen.set()

    def _admitted(self) -> bool:
        origin = self.headers.get("Origin", f"http://{self.server.host}")
        if self.headers.get("Host") == self.server.host and origin == f"http://{self.server.host}":
            return True
        self._answer(HTTPStatus.FORBIDDEN)
        return False

    def _keyed(self) -> bool:
        given = self.headers.get("Authorization", "").removeprefix("Bearer ")
        if secrets.compare_digest(given.encode("latin-1", "replace"), self.server.key.encode()):
            return True
        self._answer(HTTPStatus.UNAUTHORIZED)
        return False

    def _body(self) -> dict[str, Any] | None:
        """Return the JSON object in the request, or None."""
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit() and int(length) <= LARGEST_BODY):
            return None
        data = self.rfile.read(int(length))
        if self.headers.get_content_type() != "application/json":
            return None
        try:
            value = json.loads(data)
        except (ValueError, RecursionError):
            return None
        return value if isinstance(value, dict) else None

    def _answer(self, status: HTTPStatus, kind: str = "text/plain", body: bytes = b"") -> None:
        self.send_response(status)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing."""
