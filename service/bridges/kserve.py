"""KServe v2 with the sequence extension, as Triton's clients speak it: a sequence is a session.

The request that starts a sequence has its first frame and the boxes, each later one a frame. Two things differ from
Triton on purpose: a sequence that finds no place is refused at once instead of queued without end, and a request of a
sequence that has ended says so and why.
"""

from __future__ import annotations

import re
import time
from importlib.metadata import version
from typing import Any

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from ..api.answers import BYTES, JSON, encode
from ..api.bodies import read, validated
from ..api.deps import Caller
from ..api.health import readyz
from ..protocol.documents import to_json
from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..protocol.requests import Options
from ..service import Service
from ..sessions.session import Session
from ..sessions.ttl_cache import TTLCache
from . import sessions
from .tensors import HEAD_LENGTH, Call, read_call, write_tensors

MODEL, VERSIONS = "mfcmt", ("1",)
EXTENSIONS = ("sequence", "sequence(string_id)", "binary_tensor_data")
# Parameters of a request that are not options of the session; the last three are accepted and do nothing.
PARAMETERS = ("sequence_id", "sequence_start", "sequence_end", "binary_data_output", "priority", "timeout", "headers")
INPUTS = [
    {"name": "FRAME", "datatype": "UINT8", "shape": [-1]},
    {"name": "BOX", "datatype": "FP32", "shape": [-1, 4]},
]
OUTPUTS = [
    {"name": "BOX", "datatype": "FP32", "shape": [-1, 4]},
    {"name": "CONFIDENCE", "datatype": "FP32", "shape": [-1]},
    {"name": "STATUS", "datatype": "BYTES", "shape": [-1]},
]
NAMES = ("BOX", "CONFIDENCE", "STATUS")
SEQUENCE = re.compile(r"[!-~]{1,128}")
MAX_ID = 2**64 - 1
LABEL = "kserve"
FULL = (ProblemCode.AT_CAPACITY, ProblemCode.OVER_QUOTA)


def router(service: Service) -> APIRouter:
    """Return the calls."""
    calls = KServe(service)
    made = APIRouter()
    made.add_api_route("/v2", calls.server, methods=["GET"])
    made.add_api_route("/v2/health/live", calls.live, methods=["GET"])
    made.add_api_route("/v2/health/ready", calls.ready, methods=["GET"])
    for path in ("/v2/models/{model}", "/v2/models/{model}/versions/{version}"):
        made.add_api_route(path, calls.model, methods=["GET"])
        made.add_api_route(f"{path}/ready", calls.model_ready, methods=["GET"])
        made.add_api_route(f"{path}/infer", calls.infer, methods=["POST"])
    return made


class KServe:
    """The calls, and which session each sequence is.

    A session carries its sequence in its label. So a sequence is found again after a restart, too.
    """

    def __init__(self, service: Service) -> None:
        settings = service.settings
        self._service = service
        keep_s = settings.max_session_s + settings.tombstone_s
        self._sequences: TTLCache[str] = TTLCache(settings.max_tombstones, keep_s, time.monotonic)

    async def server(self) -> Response:
        """Say what serves."""
        return encode(JSON, {"name": "mfcmt", "version": version("mfcmt"), "extensions": EXTENSIONS})

    async def live(self) -> Response:
        """Answer as long as the process lives."""
        return encode(JSON, {"live": True})

    async def ready(self) -> Response:
        """Answer with 200 while new sequences are welcome."""
        return await readyz(self._service)

    async def model(self, model: str, version: str = VERSIONS[0]) -> Response:
        """Say what the model takes and gives."""
        _check_model(model, version)
        about = {"name": MODEL, "versions": VERSIONS, "platform": "mfcmt", "inputs": INPUTS, "outputs": OUTPUTS}
        return encode(JSON, about)

    async def model_ready(self, model: str, version: str = VERSIONS[0]) -> Response:
        """Answer with 200 while new sequences are welcome."""
        _check_model(model, version)
        return await readyz(self._service)

    async def infer(self, request: Request, caller: Caller, model: str, version: str = VERSIONS[0]) -> Response:
        """Track the targets of a sequence in its next frame."""
        _check_model(model, version)
        if request.headers.get("content-encoding", "identity") != "identity":
            raise ProblemError(ProblemCode.UNSUPPORTED_MEDIA_TYPE, "the body is not compressed: images are already")
        service, settings = self._service, self._service.settings
        service.rate_limiter.count_frame(caller)
        limit = settings.max_frame_bytes + settings.max_body_bytes
        body = await read(request, limit, settings, ProblemCode.FRAME_TOO_LARGE)
        call = await read_call(body, request.headers.get(HEAD_LENGTH), settings)
        _check_outputs(call)
        label = _label(call.parameters.get("sequence_id"))
        options = {name: value for name, value in call.parameters.items() if name not in PARAMETERS}
        if call.flag("sequence_start"):
            session = await self._start(caller, label, call, validated(Options, options | {"label": label}))
            targets = session.target_maps()
        else:
            session = self._find(caller, label)
            if call.boxes is not None or options:
                detail = "BOX and options are for the request that starts the sequence (sequence_start)"
                raise ProblemError(ProblemCode.BAD_REQUEST, detail)
            found = await sessions.track(service, session, call.frame, request.scope["state"].get("span"))
            targets = found["targets"]
        if call.flag("sequence_end"):
            service.registry.close(caller, session.id)
        return _answer(call, targets)

    async def _start(self, owner: str, label: str, call: Call, options: Options) -> Session:
        """Return the session of a sequence that begins. One of the same id ends, as in Triton."""
        if call.boxes is None:
            raise ProblemError(ProblemCode.BAD_REQUEST, "the input BOX is missing: FP32, [4] or [N, 4], x, y, w, h")
        service, before = self._service, self._live(owner, label)
        try:
            session = await sessions.create(service, owner, call.frame, call.boxes, options)
        except ProblemError as refused:
            if before is None or refused.code not in FULL:
                raise
            service.registry.close(owner, before.id)  # its place is the only one
            session = await sessions.create(service, owner, call.frame, call.boxes, options)
        if before is not None:
            service.registry.close(owner, before.id)
        self._sequences.put(owner, _key(owner, label), session.id)
        return session

    def _find(self, owner: str, label: str) -> Session:
        """Return the session of a sequence. Raises bad-request if none has begun, session-gone."""
        sid = self._sequences.get(_key(owner, label))
        if sid is None and (found := self._service.registry.labelled(owner, label)) is not None:
            sid = found.id  # it began before a restart
            self._sequences.put(owner, _key(owner, label), sid)
        if sid is not None:
            try:
                return self._service.registry.find(owner, sid)
            except ProblemError as refused:
                if refused.code is not ProblemCode.SESSION_NOT_FOUND:
                    raise
                self._sequences.pop(_key(owner, label))  # ended long ago
        detail = (
            f"inference request for sequence {label[len(LABEL) + 1 :]} to model '{MODEL}' must specify the START flag"
        )
        raise ProblemError(ProblemCode.BAD_REQUEST, f"{detail} on the first request of the sequence (sequence_start)")

    def _live(self, owner: str, label: str) -> Session | None:
        try:
            return self._find(owner, label)
        except ProblemError:
            return None


def _check_model(model: str, version: str) -> None:
    if model != MODEL or version not in VERSIONS:
        raise ProblemError(ProblemCode.NOT_FOUND, f"no such model or version; there is {MODEL!r}, version 1")


def _check_outputs(call: Call) -> None:
    for name in call.outputs:
        if name not in NAMES:
            raise ProblemError(ProblemCode.BAD_REQUEST, f"no output {name[:40]!r}; there are {', '.join(NAMES)}")


def _label(sequence_id: Any) -> str:
    """Return the label of a sequence's session: ``kserve#7`` for a number, ``kserve:cam-1`` for a text."""
    if type(sequence_id) is int and 0 < sequence_id <= MAX_ID:
        return f"{LABEL}#{sequence_id}"
    if type(sequence_id) is str and SEQUENCE.fullmatch(sequence_id):
        return f"{LABEL}:{sequence_id}"
    detail = "sequence_id is a whole number above 0 or a text of at most 128 printable characters without spaces"
    raise ProblemError(ProblemCode.BAD_REQUEST, detail)


def _key(owner: str, label: str) -> str:
    return f"{owner} {label}"


def _answer(call: Call, targets: list[dict[str, Any]]) -> Response:
    """Return the outputs that were asked for, all by default, in binary where that was asked for."""
    boxes = [value for target in targets for value in target["box"]]
    confidences = [1.0 if target["confidence"] is None else target["confidence"] for target in targets]
    statuses = [str(target["status"]) for target in targets]
    values = {
        "BOX": ("FP32", [len(targets), 4], boxes),
        "CONFIDENCE": ("FP32", [len(targets)], confidences),
        "STATUS": ("BYTES", [len(targets)], statuses),
    }
    binary = call.outputs or dict.fromkeys(NAMES, call.flag("binary_data_output"))
    outputs, tail = write_tensors({name: values[name] for name in binary}, binary)
    head: dict[str, Any] = {"model_name": MODEL, "model_version": VERSIONS[0], "outputs": outputs}
    if call.id is not None:
        head["id"] = call.id
    text = to_json(head).encode()
    if not tail:
        return Response(text, media_type=JSON)
    return Response(text + tail, headers={HEAD_LENGTH: str(len(text))}, media_type=BYTES)
