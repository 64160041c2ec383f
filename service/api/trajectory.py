"""Trajectories: the past results of a session, streamed in four formats."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import msgpack
from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from ..protocol.answers import PastResult, Trajectory, message
from ..protocol.documents import to_json
from ..protocol.enums import ProblemCode, Status, TrajectoryFormat
from ..protocol.examples import TRAJECTORY_TEXT
from ..protocol.problems import ProblemError
from ..protocol.target import ROW_FIELDS, rows_to_maps
from ..protocol.values import MAX_SEQ
from ..service import Service
from ..sessions.session import Session
from ..sessions.trajectory import TrajectoryEntry, unpacked
from . import contract
from .answers import JSON, MSGPACK, in_parts, preferred
from .deps import ServiceDep, SessionDep

router = APIRouter(tags=["trajectory"])
Packed = list[tuple[int, bytes]]
# Targets, and one more for each frame, that are encoded between two turns of the event loop: well under a millisecond.
ROWS_AT_ONCE = 24
CSV_HEAD = "seq,ts,target,x,y,w,h,status,reliable,scale,confidence\n"
BY_STATUS = {Status.TRACKING: 1.0, Status.UNCERTAIN: 0.5, Status.LOST: 0.0}
"""The confidence of MOT for results that an older version kept."""
_CONFIDENCE = ROW_FIELDS.index("confidence")


@router.get(
    "/sessions/{session_id}/trajectory",
    response_model=Trajectory,
    response_description="tracked frames by rising `seq`, streamed",
    responses={
        200: {
            "content": {
                "text/csv": {"schema": {"type": "string"}, "example": TRAJECTORY_TEXT["csv"]},
                "text/plain": {
                    "schema": {"type": "string"},
                    "examples": {name: {"value": TRAJECTORY_TEXT[name]} for name in ("otb", "mot")},
                },
            }
        },
        **contract.problems(*contract.ANY_CALL, *contract.NEGOTIATED, *contract.ON_SESSION, "bad-request"),
    },
)
async def get_trajectory(
    request: Request,
    session: SessionDep,
    service: ServiceDep,
    format: Annotated[TrajectoryFormat, Query(description="`otb` needs `target`")] = TrajectoryFormat.JSON,
    after: Annotated[int, Query(ge=-1, le=MAX_SEQ, description="frames above this number")] = -1,
    target: Annotated[int | None, Query(ge=0, le=MAX_SEQ, description="one target alone")] = None,
) -> Response:
    """Get every tracked frame, the first one included. OTB and MOT count from 1."""
    if format is TrajectoryFormat.OTB and target is None:
        raise ProblemError(ProblemCode.BAD_REQUEST, "otb needs target")
    kind = _media_type(request, format)
    packed = session.trajectory.after(after)
    if format is TrajectoryFormat.JSON:
        whole = _msgpack if kind == MSGPACK else _json
        return _InParts(service, session.owner, whole(session, packed, target), kind)
    return _InParts(service, session.owner, _LINES[format](unpacked(packed), target), kind)


def _media_type(request: Request, format: TrajectoryFormat) -> str:
    """Return the media type of the answer. Raises not-acceptable."""
    if format is TrajectoryFormat.JSON:
        return preferred(request, JSON, MSGPACK)
    kind = "text/csv" if format is TrajectoryFormat.CSV else "text/plain"
    # A client that asks for JSON in every call still gets the format that it names here.
    preferred(request, kind, JSON, MSGPACK)
    return kind


class _InParts(StreamingResponse):
    """An answer in parts, between which the event loop does other work; each key has a few of them at once."""

    def __init__(self, service: Service, owner: str, parts: Iterator[bytes], media_type: str) -> None:
        super().__init__(in_parts(parts), media_type=media_type)
        self._service, self._owner = service, owner

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it. Raises over-quota."""
        async with self._service.trajectory_slots.slot(self._owner):
            await super().__call__(scope, receive, send)


def _some(entries: Iterator[TrajectoryEntry]) -> Iterator[list[TrajectoryEntry]]:
    """Yield the entries in lists with few targets each."""
    some: list[TrajectoryEntry] = []
    rows = 0
    for entry in entries:
        some.append(entry)
        rows += 1 + len(entry.rows)
        if rows >= ROWS_AT_ONCE:
            yield some
            some, rows = [], 0
    if some:
        yield some


def _json(session: Session, packed: Packed, target: int | None) -> Iterator[bytes]:
    yield f'{{"id":{to_json(session.id)},"results":['.encode()
    comma = ""
    for some in _some(unpacked(packed)):
        yield (comma + ",".join(to_json(_frame(entry, target)) for entry in some)).encode()
        comma = ","
    yield b"]}"


def _msgpack(session: Session, packed: Packed, target: int | None) -> Iterator[bytes]:
    packer = msgpack.Packer()
    head = packer.pack_map_header(2) + packer.pack("id") + packer.pack(session.id) + packer.pack("results")
    yield head + packer.pack_array_header(len(packed))
    for some in _some(unpacked(packed)):
        yield b"".join(packer.pack(_frame(entry, target)) for entry in some)


def _frame(entry: TrajectoryEntry, target: int | None) -> dict[str, Any]:
    return message(
        PastResult,
        seq=entry.seq,
        ts=entry.ts,
        size=entry.size,
        region=entry.region,
        targets=rows_to_maps(_rows(entry, target)),
    )


def _rows(entry: TrajectoryEntry, target: int | None) -> list[list[Any]]:
    return entry.rows if target is None else [row for row in entry.rows if row[0] == target]


def _csv(entries: Iterator[TrajectoryEntry], target: int | None) -> Iterator[bytes]:
    yield CSV_HEAD.encode()
    for some in _some(entries):
        yield "".join(_csv_line(entry, row) for entry in some for row in _rows(entry, target)).encode()


def _csv_line(entry: TrajectoryEntry, row: list[Any]) -> str:
    target = dict(zip(ROW_FIELDS, row, strict=True))
    x, y, w, h = target["box"]
    verdict = "" if target["reliable"] is None else str(target["reliable"]).lower()
    confidence = "" if target["confidence"] is None else repr(target["confidence"])
    return (
        f"{entry.seq},{_quoted(entry.ts)},{target['id']},{x!r},{y!r},{w!r},{h!r},{target['status']},{verdict},"
        f"{target['scale']!r},{confidence}\n"
    )


def _otb(entries: Iterator[TrajectoryEntry], target: int | None) -> Iterator[bytes]:
    for some in _some(entries):
        boxes = (row[1] for entry in some for row in _rows(entry, target))
        yield "".join(f"{x + 1!r},{y + 1!r},{w!r},{h!r}\n" for x, y, w, h in boxes).encode()


def _mot(entries: Iterator[TrajectoryEntry], target: int | None) -> Iterator[bytes]:
    for some in _some(entries):
        yield "".join(_mot_line(entry, row) for entry in some for row in _rows(entry, target)).encode()


def _mot_line(entry: TrajectoryEntry, row: list[Any]) -> str:
    tid, (x, y, w, h), status, *_ = row
    box = f"{x + 1!r},{y + 1!r},{w!r},{h!r}"
    confidence = row[_CONFIDENCE]
    if confidence is None:
        confidence = BY_STATUS[status]
    return f"{entry.seq + 1},{tid + 1},{box},{confidence!r},-1,-1,-1\n"


_LINES = {TrajectoryFormat.CSV: _csv, TrajectoryFormat.OTB: _otb, TrajectoryFormat.MOT: _mot}


def _quoted(ts: float | str | None) -> str:
    if ts is None:
        return ""
    text = str(ts)
    # Quotes keep a spreadsheet from running the cell as a formula, and the cell from breaking the line.
    if text[:1] in "=+-@" and isinstance(ts, str):
        text = "'" + text
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\r\n') else text
