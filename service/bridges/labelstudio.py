"""Label Studio's ML backend: a rectangle that a person draws in a video is tracked from there on.

Label Studio sends a URL instead of frames, so the video is fetched from hosts that the operator allows
(``MFCMT_VIDEO_HOSTS``) and read in a process of its own.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import aclosing
from math import ceil
from typing import Any
from urllib.parse import urljoin, urlsplit

import structlog
from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from ..api.answers import JSON, encode
from ..api.bodies import read
from ..api.deps import Caller
from ..protocol.documents import Unreadable, from_json
from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..protocol.requests import Options
from ..service import Service
from ..sessions.concurrency import ConcurrencyLimit
from ..sessions.session import Session
from ..sessions.ttl_cache import TTLCache
from . import sessions, videos
from .labelstudio_tasks import MODEL_VERSION, Track, prediction, tracks_of, video_of
from .videos import PORTS, VideoFrame

# Label Studio waits 100 s for an answer. What was tracked until then is answered; a person goes on from its end.
PREDICT_S = 80.0
# Videos of one key that are tracked at once; others wait for their turn.
VIDEOS_AT_ONCE, WAIT_S = 2, 10.0
MAX_BODY_BYTES = 256 * 1024
MAX_TASKS = 100
# Projects whose address and token are remembered, of each key, and how long.
MAX_PROJECTS, KEEP_S = 100, 7 * 86400.0

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.labelstudio")


def router(service: Service) -> APIRouter:
    """Return the calls."""
    calls = LabelStudio(service)
    made = APIRouter()
    made.add_api_route("/labelstudio/health", calls.health, methods=["GET"])
    made.add_api_route("/labelstudio/setup", calls.setup, methods=["POST"])
    made.add_api_route("/labelstudio/predict", calls.predict, methods=["POST"])
    made.add_api_route("/labelstudio/webhook", calls.webhook, methods=["POST"])
    if not service.settings.video_hosts:
        log.warning("no MFCMT_VIDEO_HOSTS: the bridge to Label Studio fetches no video")
    return made


class LabelStudio:
    """The calls of an ML backend. The token of a project stays in memory, and goes to the project's own host alone."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._projects: TTLCache[tuple[str, str]] = TTLCache(MAX_PROJECTS, KEEP_S, time.monotonic)
        self._client = videos.make_client()
        self._slots = ConcurrencyLimit(VIDEOS_AT_ONCE, WAIT_S, "videos")

    async def health(self, _caller: Caller) -> Response:
        """Answer as long as the process lives."""
        return encode(JSON, {"status": "UP", "model_class": "MFCMT"})

    async def setup(self, request: Request, caller: Caller) -> Response:
        """Remember where a project's videos are, and the token for them."""
        sent = await self._read(request)
        project, host, token = (sent.get(name) or "" for name in ("project", "hostname", "access_token"))
        if not all(type(text) is str and len(text) <= 4096 for text in (project, host, token)):
            raise _bad("project, hostname and access_token are texts")
        self._projects.put(caller, f"{caller} {project}", (host, token))
        return encode(JSON, {"model_version": MODEL_VERSION})

    async def webhook(self, request: Request, _caller: Caller) -> Response:
        """Take note of what happens in a project: nothing follows from it."""
        await self._read(request)
        return encode(JSON, {"result": {}, "status": "ok"}, 201)

    async def predict(self, request: Request, caller: Caller) -> Response:
        """Track the rectangles of each task to the end of its video, or as far as the time goes."""
        sent = await self._read(request)
        tasks, config, project = sent.get("tasks"), sent.get("label_config") or "", sent.get("project") or ""
        params = sent.get("params") or {}
        context = params.get("context") if isinstance(params, dict) else None
        if type(tasks) is not list or len(tasks) > MAX_TASKS or not all(isinstance(task, dict) for task in tasks):
            raise _bad(f"tasks is a list of at most {MAX_TASKS} tasks")
        if type(config) is not str or type(project) is not str or not (context is None or isinstance(context, dict)):
            raise _bad("label_config and project are texts, and params.context is a map")
        until = time.monotonic() + PREDICT_S
        results = []
        for task in tasks:
            tracks = tracks_of(task, context)
            size = (1, 1)
            if tracks:
                url = video_of(task, config, tracks[0].to_name)
                async with self._slots.slot(caller):
                    size = await self._track(caller, project, url, tracks, until)
            tracked = [track for track in tracks if track.rows]
            results.append(await asyncio.to_thread(prediction, tracked, size))
        return encode(JSON, {"results": results})

    async def _read(self, request: Request) -> dict[str, Any]:
        data = await read(request, MAX_BODY_BYTES, self._service.settings)
        try:
            sent = from_json(bytes(data), MAX_BODY_BYTES)
        except Unreadable as unreadable:
            raise _bad(str(unreadable)) from unreadable
        if not isinstance(sent, dict):
            raise _bad("the body is a map of named fields")
        return sent

    async def _track(self, owner: str, project: str, url: str, tracks: list[Track], until: float) -> tuple[int, int]:
        """Fetch the video, add rows to the tracks, and return the size of the frames in pixels."""
        host, token = self._projects.get(f"{owner} {project}") or ("", "")
        url, home = urljoin(host, url), _host_of(host)

        def headers_of(where: str) -> dict[str, str]:
            return {"Authorization": f"Token {token}"} if token and where == home else {}

        async with videos.fetched(self._client, url, self._service.settings, headers_of) as path:
            first = min(tracks, key=lambda track: track.start)
            found = videos.frames(path, (first.start - 1) / first.fps, self._service.settings)
            async with aclosing(found) as read_frames:
                return await self._follow(owner, read_frames, tracks, until)

    async def _follow(
        self, owner: str, found: AsyncIterator[VideoFrame], tracks: list[Track], until: float
    ) -> tuple[int, int]:
        """Track through the frames. A track joins in the first one at or after its start."""
        session: Session | None = None
        joined: dict[int, Track] = {}
        waiting = sorted(tracks, key=lambda track: track.start)
        size = (1, 1)
        try:
            async for frame in found:
                size = frame.size
                due = [track for track in waiting if frame.time_s >= (track.start - 1.5) / track.fps]
                waiting = waiting[len(due) :]
                if session is None and not due:
                    continue
                self._service.rate_limiter.count_frame(owner)
                if session is None:
                    boxes = [track.box(size) for track in due]
                    session = await sessions.create(
                        self._service, owner, frame.jpeg, boxes, Options(label="labelstudio")
                    )
                    joined = {target["id"]: track for target, track in zip(session.target_maps(), due, strict=True)}
                else:
                    await sessions.track(self._service, session, frame.jpeg, None)
                    for track in due:
                        target, _ = await session.control({"type": "add", "box": track.box(size)})
                        assert target is not None
                        joined[target["id"]] = track
                for target in session.target_maps():
                    track = joined[target["id"]]
                    track.add(max(track.start, 1 + _nearest(frame.time_s * track.fps)), target)
                if time.monotonic() > until:
                    break
        finally:
            if session is not None:
                self._service.registry.close(owner, session.id)
        return size


def _nearest(value: float) -> int:
    return ceil(value - 0.5)


def _host_of(url: str) -> str:
    """Return ``host:port`` of a URL, "" if it has none."""
    try:
        parts = urlsplit(url)
        port = parts.port or PORTS.get(parts.scheme)
    except ValueError:
        return ""
    return f"{(parts.hostname or '').lower()}:{port}" if parts.hostname and port else ""


def _bad(detail: str) -> ProblemError:
    return ProblemError(ProblemCode.BAD_REQUEST, detail)
