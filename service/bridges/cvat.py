"""CVAT's serverless functions: the service looks like a Nuclio dashboard with one function, which tracks rectangles.

CVAT sends a frame with the shapes that begin in it and the states of the others, and keeps the states that it gets
back. A state is a session of its own, as long as all states of a call are small; the states of many objects or large
frames name targets of sessions that go on here.
"""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from mfcmt_core.images import sniff

from ..api.answers import JSON, encode
from ..api.bodies import HELD, read
from ..api.deps import Caller
from ..protocol.documents import to_json, to_msgpack
from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..protocol.requests import Options
from ..protocol.values import check_box
from ..service import Service
from ..sessions.byte_budget import Reservation
from ..sessions.session import Session
from . import large_json, sessions
from .cvat_states import POINTER, VALUE, State, seal, unseal
from .large_json import Document

if TYPE_CHECKING:
    from opentelemetry.trace import Span

FUNCTION = "mfcmt"
MAX_OBJECTS = 256
# New objects are given states that hold all of them if these have at most as many bytes in all.
VALUES_BYTES = 16 * 1024 * 1024
# About what a target takes of a snapshot, beside the frame.
TARGET_BYTES = 750 * 1024
# Beside image and states.
ENVELOPE_BYTES = 64 * 1024
SHAPE = "a shape is [x1, y1, x2, y2], or a map of the type rectangle with such points"
IMAGE = "image is a JPEG, PNG or WebP file"


def router(service: Service) -> APIRouter:
    """Return the calls."""
    calls = Cvat(service)
    made = APIRouter()
    made.add_api_route("/api/functions", calls.functions, methods=["GET"])
    made.add_api_route("/api/functions/{name}", calls.function, methods=["GET"])
    made.add_api_route("/api/function_invocations", calls.invoke, methods=["POST"])
    return made


@dataclass(frozen=True, slots=True)
class Found:
    """What came of one object: its box, or None while it is not found, and its next state."""

    box: list[float] | None
    state: State


@dataclass(frozen=True, slots=True)
class Invocation:
    """A call of the function: a frame, the objects that begin in it and those that go on, by their places."""

    owner: str
    image: bytes | memoryview
    threshold: float
    new: dict[int, tuple[list[float], bool]]
    known: dict[int, State]
    span: Span | None


class Cvat:
    """The calls of a Nuclio dashboard that CVAT makes."""

    def __init__(self, service: Service) -> None:
        self._service = service

    async def functions(self, _caller: Caller) -> Response:
        """List the one function."""
        return encode(JSON, {FUNCTION: _about(self._service.settings.port)})

    async def function(self, _caller: Caller, name: str) -> Response:
        """Describe the function."""
        _check_name(name)
        return encode(JSON, _about(self._service.settings.port))

    async def invoke(self, request: Request, caller: Caller) -> Response:
        """Start and track objects in one frame."""
        _check_name(request.headers.get("x-nuclio-function-name", FUNCTION))
        self._service.rate_limiter.count_frame(caller)
        settings = self._service.settings
        limit = (settings.max_frame_bytes + settings.max_snapshot_bytes) * 4 // 3 + ENVELOPE_BYTES
        document = await large_json.parse(await read(request, limit, settings), settings.max_body_bytes)
        sent = await self._read(document, caller, request.scope["state"].get("span"))
        begun: list[Session] = []
        try:
            found = await self._start(sent, begun) | await self._follow(sent)
        except BaseException:
            for session in begun:
                self._service.registry.close(caller, session.id)
            raise
        states = [await seal(self._service.signer, caller, found[place].state) for place in sorted(found)]
        share: Reservation = request.scope["state"][HELD]
        share.grow(sum(map(len, states)))
        return StreamingResponse(_answer([_shape(found[place]) for place in sorted(found)], states), media_type=JSON)

    async def _read(self, document: Document, owner: str, span: Span | None) -> Invocation:
        """Return the call with all that it says checked. Raises bad-request, bad-box, bad-snapshot, frame-too-large."""
        sent = document.value if isinstance(document.value, dict) else {}
        shapes, states, threshold = sent.get("shapes"), sent.get("states"), sent.get("threshold")
        if type(shapes) is not list or type(states) is not list or not len(states) <= len(shapes) <= MAX_OBJECTS:
            raise _bad(f"shapes is a list of at most {MAX_OBJECTS} objects, and states one that is not longer")
        if threshold is not None and type(threshold) not in (int, float):
            raise _bad("threshold is a number")
        image = await document.decode(sent.get("image"), "image")
        if len(image) > (most := self._service.settings.max_frame_bytes):
            raise ProblemError(ProblemCode.FRAME_TOO_LARGE, f"{len(image)} bytes; at most {most}")
        if sniff(image) is None:
            raise _bad(IMAGE)
        new, known = {}, {}
        for place, (shape, state) in enumerate(itertools.zip_longest(shapes, states)):
            if state is None:
                new[place] = _box(shape)
            else:
                known[place] = await unseal(self._service.signer, owner, document, state)
        return Invocation(owner, image, threshold or 0.0, new, known, span)

    async def _start(self, sent: Invocation, begun: list[Session]) -> dict[int, Found]:
        """Start the new objects, add their sessions to ``begun``, and return what they are given by their places."""
        settings = self._service.settings
        as_values = len(sent.new) * (len(sent.image) + TARGET_BYTES) <= VALUES_BYTES
        idle_s = None if as_values else settings.max_idle_timeout_s
        size = 1 if as_values else settings.max_targets_per_session
        found = {}
        for places in _batches(list(sent.new), size):
            boxes = [sent.new[place][0] for place in places]
            options = Options(label="cvat", idle_timeout_s=idle_s)
            session = await sessions.create(self._service, sent.owner, sent.image, boxes, options)
            begun.append(session)
            contents = [await self._packed(session)] if as_values else _pointers(session)
            for place, box, content in zip(places, boxes, contents, strict=True):
                kind = VALUE if as_values else POINTER
                found[place] = Found(box, State(kind, sent.new[place][1], content))
        return found

    async def _follow(self, sent: Invocation) -> dict[int, Found]:
        """Track the known objects, and return what came of each by its place."""
        found = {}
        followed: dict[str, dict[int, dict[str, Any]]] = {}
        for place, state in sent.known.items():
            if state.kind == VALUE:
                session = await sessions.restore(self._service, sent.owner, state.contents)
                try:
                    target = (await self._track(session, sent))[0]
                except BaseException:
                    self._service.registry.close(sent.owner, session.id)
                    raise
                state = State(VALUE, state.typed, await self._packed(session))
            else:
                sid, target_id = state.place
                if sid not in followed:
                    targets = await self._track(self._service.registry.find(sent.owner, sid), sent)
                    followed[sid] = {target["id"]: target for target in targets}
                if target_id not in followed[sid]:
                    raise ProblemError(ProblemCode.TARGET_NOT_FOUND, f"no target {target_id}: start the track again")
                target = followed[sid][target_id]
            seen = target["status"] != "lost" and target["confidence"] >= sent.threshold
            found[place] = Found(target["box"] if seen else None, state)
        return found

    async def _track(self, session: Session, sent: Invocation) -> list[dict[str, Any]]:
        try:
            result = await sessions.track(self._service, session, sent.image, sent.span)
        except ProblemError as refused:
            if refused.code is ProblemCode.FRAME_SIZE_CHANGED:
                raise _bad(f"image: {refused.detail}; a track goes on in frames of one size") from refused
            raise
        targets: list[dict[str, Any]] = result["targets"]
        return targets

    async def _packed(self, session: Session) -> bytes | memoryview:
        """Return a session as a snapshot, and end it."""
        try:
            async with self._service.snapshot_slots.slot(session.owner):
                return await session.snapshot()
        finally:
            self._service.registry.close(session.owner, session.id)


def _about(port: int) -> dict[str, Any]:
    """Return what a Nuclio dashboard says of the function."""
    annotations = {
        "name": "MFCMT",
        "type": "tracker",
        "spec": "",
        "version": "1",
        "supported_shape_types": "rectangle",
    }
    return {
        "metadata": {"name": FUNCTION, "annotations": annotations},
        "spec": {"description": "Tracks a rectangle from frame to frame"},
        "status": {"state": "ready", "httpPort": port},
    }


def _check_name(name: str) -> None:
    if name != FUNCTION:
        raise ProblemError(ProblemCode.NOT_FOUND, f"there is one function, {FUNCTION!r}")


def _box(shape: Any) -> tuple[list[float], bool]:
    """Return the box of a shape, and whether it came as a map. Raises bad-request, bad-box."""
    typed = type(shape) is dict
    points = shape.get("points") if typed else shape
    if (typed and shape.get("type") != "rectangle") or type(points) is not list or len(points) != 4:
        raise _bad(SHAPE)
    if any(type(value) not in (int, float) for value in points):
        raise _bad(SHAPE)
    left, top, right, bottom = points
    return check_box([left, top, right - left, bottom - top]), typed


def _shape(found: Found) -> Any:
    if found.box is None:
        return None
    x, y, w, h = found.box
    points = [x, y, x + w, y + h]
    return {"type": "rectangle", "points": points} if found.state.typed else points


async def _answer(shapes: list[Any], states: list[bytes]) -> AsyncIterator[bytes]:
    """Yield the answer, with the states in base64."""
    yield b'{"shapes":%b,"states":[' % to_json(shapes).encode()
    for place, state in enumerate(states):
        yield b',"' if place else b'"'
        async for piece in large_json.encode(state):
            yield piece
        yield b'"'
    yield b"]}"


def _batches(places: list[int], size: int) -> list[list[int]]:
    return [places[at : at + size] for at in range(0, len(places), size)]


def _pointers(session: Session) -> list[bytes]:
    return [to_msgpack([session.id, target["id"]]) for target in session.target_maps()]


def _bad(detail: str) -> ProblemError:
    return ProblemError(ProblemCode.BAD_REQUEST, detail)
