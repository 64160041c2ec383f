"""The past of a session, streamed in four formats."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from itertools import islice
from typing import Annotated, Any, Literal

import msgpack
from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from ..problems import ProblemError
from ..schemas import fields
from ..schemas.packed import to_json
from ..sessions import wiring
from ..sessions.session import Session
from ..sessions.trajectory import Entry, unpacked
from . import contract
from .answers import chosen_type
from .bodies import JSON, MSGPACK
from .deps import SessionDep

router = APIRouter(tags=["trajectory"])
Format = Literal["json", "csv", "otb", "mot"]
Packed = list[tuple[int, bytes]]
# Frames that are put together between two turns of the event loop: well under a millisecond.
FRAMES_AT_ONCE = 32
CSV_HEAD = "seq,ts,target,x,y,w,h,status,reliable,scale\n"
CONFIDENCE = {"tracking": "1", "uncertain": "0.5", "lost": "0"}


@router.get("/sessions/{session_id}/trajectory", **contract.TRAJECTORY)
async def get_trajectory(
    request: Request,
    session: SessionDep,
    format: Annotated[Format, Query(description="`otb` needs `target`")] = "json",
    after: Annotated[int, Query(ge=-1, le=fields.MAX_SEQ, description="frames above this number")] = -1,
    target: Annotated[int | None, Query(ge=0, le=fields.MAX_SEQ, description="one target alone")] = None,
) -> Response:
    """Every tracked frame, the creating one too. OTB and MOT count from 1."""
    if format == "otb" and target is None:
        raise ProblemError("bad-request", "otb needs target")
    kind = _media_type(request, format)
    packed = session.trajectory.after(after)
    if format == "json":
        whole = _msgpack if kind == MSGPACK else _json
        return StreamingResponse(_parts(whole(session, packed, target)), media_type=kind)
    return StreamingResponse(_parts(_chunks(_LINES[format](unpacked(packed), target))), media_type=kind)


def _media_type(request: Request, format: Format) -> str:
    """The media type of the answer. Raises not-acceptable."""
    if format == "json":
        return chosen_type(request, JSON, MSGPACK)
    kind = "text/csv" if format == "csv" else "text/plain"
    # Clients that ask for JSON in every call mean the format that they name here.
    chosen_type(request, kind, JSON, MSGPACK)
    return kind


async def _parts(parts: Iterator[bytes]) -> AsyncIterator[bytes]:
    # Each part is sent before the next is made, and sending yields to the loop.
    for part in parts:
        yield part


def _json(session: Session, packed: Packed, target: int | None) -> Iterator[bytes]:
    yield f'{{"id":{to_json(session.id)},"results":['.encode()
    entries, comma = iter(unpacked(packed)), ""
    while some := list(islice(entries, FRAMES_AT_ONCE)):
        yield (comma + ",".join(to_json(_frame(entry, target)) for entry in some)).encode()
        comma = ","
    yield b"]}"


def _msgpack(session: Session, packed: Packed, target: int | None) -> Iterator[bytes]:
    packer = msgpack.Packer()
    head = packer.pack_map_header(2) + packer.pack("id") + packer.pack(session.id) + packer.pack("results")
    yield head + packer.pack_array_header(len(packed))
    entries = iter(unpacked(packed))
    while some := list(islice(entries, FRAMES_AT_ONCE)):
        yield b"".join(packer.pack(_frame(entry, target)) for entry in some)


def _frame(entry: Entry, target: int | None) -> dict[str, Any]:
    return {
        "seq": entry.seq,
        "ts": entry.ts,
        "size": entry.size,
        "region": entry.region,
        "targets": wiring.targets(_rows(entry, target)),
    }


def _rows(entry: Entry, target: int | None) -> list[list[Any]]:
    return entry.rows if target is None else [row for row in entry.rows if row[0] == target]


def _csv(entries: Iterator[Entry], target: int | None) -> Iterator[str]:
    yield CSV_HEAD
    for entry in entries:
        for tid, (x, y, w, h), status, reliable, *_, scale in _rows(entry, target):
            told = "" if reliable is None else str(reliable).lower()
            yield f"{entry.seq},{_quoted(entry.ts)},{tid},{x!r},{y!r},{w!r},{h!r},{status},{told},{scale!r}\n"


def _otb(entries: Iterator[Entry], target: int | None) -> Iterator[str]:
    for entry in entries:
        for _, (x, y, w, h), *_ in _rows(entry, target):
            yield f"{x + 1!r},{y + 1!r},{w!r},{h!r}\n"


def _mot(entries: Iterator[Entry], target: int | None) -> Iterator[str]:
    for entry in entries:
        for tid, (x, y, w, h), status, *_ in _rows(entry, target):
            box = f"{x + 1!r},{y + 1!r},{w!r},{h!r}"
            yield f"{entry.seq + 1},{tid + 1},{box},{CONFIDENCE[status]},-1,-1,-1\n"


_LINES = {"csv": _csv, "otb": _otb, "mot": _mot}


def _chunks(lines: Iterator[str]) -> Iterator[bytes]:
    while some := list(islice(lines, 4 * FRAMES_AT_ONCE)):
        yield "".join(some).encode()


def _quoted(ts: float | str | None) -> str:
    if ts is None:
        return ""
    text = str(ts)
    # A cell that a spreadsheet would run as a formula, or that would break the line, is quoted.
    if text[:1] in "=+-@" and isinstance(ts, str):
        text = "'" + text
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\r\n') else text
