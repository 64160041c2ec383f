"""A stand-in for CVAT's server, with what an agent asks it for: a task of some frames and a queue of requests.

The lines of the queue that begin with @ name a state of an earlier answer: {"states": ["@0"]}.
"""

from __future__ import annotations

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Self
from urllib.parse import parse_qs, urlsplit

VERSION = "2.80.0"


class FakeCvat:
    """Serves on a loopback port; ``completed`` and ``failed`` are the bodies that the agent has sent, by request."""

    def __init__(self, frames: list[bytes], sizes: list[tuple[int, int]], requests: list[dict[str, Any]]) -> None:
        self.frames, self.sizes = frames, sizes
        self.queue = list(enumerate(requests))
        self.completed: dict[int, dict[str, Any]] = {}
        self.failed: dict[int, str] = {}
        self.created: list[dict[str, Any]] = []
        self.states: list[str] = []
        fake = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                self.answer(fake.get(urlsplit(self.path)))

            def do_POST(self) -> None:
                data = self.rfile.read(int(self.headers.get("Content-Length", 0)))
                self.answer(fake.post(urlsplit(self.path).path, json.loads(data or b"{}")))

            def answer(self, content: Any) -> None:
                data = content if isinstance(content, bytes) else json.dumps(content).encode()
                self.send_response(404 if content is None else 200)
                self.send_header("Content-Type", "image/jpeg" if isinstance(content, bytes) else "application/json")
                self.send_header("Content-Length", str(len(data)))
                self.end_headers()
                self.wfile.write(data)

            def log_message(self, format: str, *args: Any) -> None:
                return

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"

    def __enter__(self) -> Self:
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()

    def get(self, url: Any) -> Any:
        """The answer to a GET; None for a path that nobody asks for."""
        words, query = url.path.strip("/").split("/"), parse_qs(url.query)
        match words:
            case ["api", "server", "about"]:
                return {"name": "CVAT", "description": "", "version": VERSION, "logo_url": "", "subtitle": ""}
            case ["api", "functions", number]:
                about = {"id": int(number), "provider": "native", "name": "MFCMT", "kind": "tracker"}
                return about | {"supported_shape_types": ["rectangle"]}
            case ["api", "tasks", number]:
                return task(int(number), len(self.frames))
            case ["api", "labels"]:
                return {"count": 0, "next": None, "previous": None, "results": []}
            case ["api", "tasks", _, "data", "meta"]:
                return meta(self.sizes)
            case ["api", "tasks", _, "data"]:
                return self.frames[int(query["number"][0])]
        return None

    def post(self, path: str, body: dict[str, Any]) -> Any:
        """The answer to a POST."""
        match path.strip("/").split("/"):
            case ["api", "functions"]:
                self.created.append(body)
                return {"id": 1, "provider": "native", "kind": "tracker", "name": body["name"]}
            case [*_, "requests", "acquire"]:
                if not self.queue or body["request_category"] != "interactive":
                    return {"ar_assignment": None}
                number, params = self.queue.pop(0)
                if "states" in params:
                    named = [self.states[int(s[1:])] if s.startswith("@") else s for s in params["states"]]
                    params = params | {"states": named}
                return {"ar_assignment": {"ar_id": str(number), "ar_params": params}}
            case [*_, "requests", number, "complete"]:
                self.completed[int(number)] = body
                if "shapes" not in body:
                    self.states += body["states"]
                return {}
            case [*_, "requests", number, "fail"]:
                self.failed[int(number)] = body["exc_info"]
                return {}
            case [*_, "requests", _, "update"]:
                return {}
        return None


def task(number: int, size: int) -> dict[str, Any]:
    """A task as the SDK reads it."""
    link = {"url": ""}
    return {
        "url": "",
        "id": number,
        "name": "a task",
        "project_id": None,
        "mode": "interpolation",
        "owner": None,
        "assignee": None,
        "bug_tracker": "",
        "created_date": "2026-01-01T00:00:00Z",
        "updated_date": "2026-01-01T00:00:00Z",
        "overlap": 0,
        "segment_size": size,
        "status": "annotation",
        "data_chunk_size": size,
        "data_compressed_chunk_type": "imageset",
        "data_original_chunk_type": "imageset",
        "size": size,
        "image_quality": 70,
        "data": 1,
        "dimension": "2d",
        "subset": "",
        "organization": None,
        "target_storage": None,
        "source_storage": None,
        "jobs": {"count": 1, "completed": 0, "validation": 0} | link,
        "labels": link,
    }


def meta(sizes: list[tuple[int, int]]) -> dict[str, Any]:
    """What the SDK reads of a task's frames."""
    frames = [
        {"width": w, "height": h, "name": f"{i}.jpg", "related_files": 0, "has_related_context": False}
        for i, (w, h) in enumerate(sizes)
    ]
    return {
        "chunk_size": len(sizes),
        "size": len(sizes),
        "image_quality": 70,
        "start_frame": 0,
        "stop_frame": len(sizes) - 1,
        "frame_filter": "",
        "chunks_updated_date": "2026-01-01T00:00:00Z",
        "frames": frames,
        "deleted_frames": [],
        "included_frames": None,
    }
