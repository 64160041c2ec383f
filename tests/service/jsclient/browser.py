"""A page of another origin than the service, under the strictest policy that the client needs; a browser to open it."""

from __future__ import annotations

import functools
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np

from tests.chromium import FLAGS

HERE = Path(__file__).parent
PACKAGE = Path(__file__).resolve().parents[3] / "service" / "web" / "client"
MSGPACK = HERE / "node_modules" / "@msgpack" / "msgpack" / "dist.esm"
CAMERA_FLAGS = [*FLAGS, "--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream"]


class Pages:
    """Serves the client at ``/static/client/``, ``frames`` and what is in ``root``; ``policy`` is the pages' CSP."""

    def __init__(self, frames: list[bytes], policy: str, root: Path = HERE) -> None:
        self.frames, self.policy, self.root = frames, policy, root
        handler = functools.partial(_Handler, self)
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self._server.server_port}"

    @property
    def frame_urls(self) -> list[str]:
        return [f"{self.origin}/frames/{index}" for index in range(len(self.frames))]

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Handler(SimpleHTTPRequestHandler):
    def __init__(self, pages: Pages, *args: Any) -> None:
        self._pages = pages
        super().__init__(*args)

    def do_GET(self) -> None:
        if self.path.startswith("/frames/"):
            data = self._pages.frames[int(self.path.rpartition("/")[2])]
            self.send_response(200)
            self.send_header("Content-Type", "image/jpeg")
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)
        elif self.path == "/favicon.ico":
            self.send_response(204)
            self.end_headers()
        else:
            super().do_GET()

    def translate_path(self, path: str) -> str:
        for prefix, folder in (("/static/client/", PACKAGE), ("/msgpack/", MSGPACK)):
            if path.startswith(prefix):
                return str(folder / path.removeprefix(prefix))
        return str(self._pages.root / path.partition("?")[0].lstrip("/"))

    def end_headers(self) -> None:
        self.send_header("Content-Security-Policy", self._pages.policy)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cache-Control", "no-store")
        super().end_headers()

    def log_message(self, format: str, *args: object) -> None:
        pass


def write_y4m(path: Path, images: list[np.ndarray], fps: int = 30) -> None:
    """A film for the browser's fake camera."""
    height, width = (side - side % 2 for side in images[0].shape[:2])
    with path.open("wb") as film:
        film.write(f"YUV4MPEG2 W{width} H{height} F{fps}:1 Ip A1:1 C420jpeg\n".encode())
        for image in images:
            film.write(b"FRAME\n" + cv2.cvtColor(image[:height, :width], cv2.COLOR_BGR2YUV_I420).tobytes())
