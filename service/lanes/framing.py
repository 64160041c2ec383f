"""Messages between front and lane: length-prefixed MessagePack over a socket pair, without a copy of a frame.

A message is ``length: u32, call: u32, payload``; the payload of a call is the array ``[op, key, args,
data]``. The payload of a reply is ``took: f32``, the processor time of the operation in seconds, and ``[code, value]``
with a problem code or nil. Call 0 gets no reply.

A large payload comes in parts, so that others need not wait for it: messages whose call has the bit ``PART`` set, with
other messages between them, and at last the end of the payload as an ordinary message. The first part begins with the
length of the whole payload, ``u32``. An empty part takes back the parts before it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Any

import msgpack

from ..landing import LARGE_BYTES, Landing
from .interface import Buffers

HEAD = struct.Struct(">II")
TOOK = struct.Struct(">f")
BIN32 = struct.Struct(">BI")
SIZE = struct.Struct(">I")
MAX_MESSAGE_BYTES = 1 << 30
HELLO, NO_REPLY = 0, 0
PART = 1 << 31
PART_BYTES = 1 << 17
LONG_BYTES = 1 << 16
LONG_VALUE = b"\x92\xc0\xc6"  # [nil, bin 32]
# The beginnings of calls whose replies hold a whole session.
LARGE_REPLIES = tuple(b"\x94" + msgpack.packb(op) for op in ("checkpoint", "snapshot"))


class FramingError(Exception):
    """Bytes arrived that are not of this protocol."""


def encode_call(op: str, key: str, args: Mapping[str, Any], data: bytes | memoryview = b"") -> Buffers:
    """Return the payload of a call: one MessagePack array whose last item is ``data`` itself, not a copy."""
    head = msgpack.packb((op, key, args))
    return (b"\x94" + head[1:] + BIN32.pack(0xC6, len(data)), data)


def is_large(request: Buffers) -> bool:
    """Return whether a call, or the reply to it, may have megabytes."""
    return len(request[-1]) > LARGE_BYTES or bytes(request[0]).startswith(LARGE_REPLIES)


def decode_call(payload: memoryview) -> tuple[str, str, dict[str, Any], bytes]:
    """Return ``op, key, args, data`` of a call."""
    op, key, args, data = msgpack.unpackb(payload)
    return op, key, args, data


def encode_value(value: Any) -> Buffers:
    """Return the payload of the reply ``[nil, value]``; long bytes are not copied."""
    if type(value) is bytes and len(value) >= LONG_BYTES:
        return (LONG_VALUE + SIZE.pack(len(value)), value)
    return (encode_reply(None, value),)


def encode_reply(code: str | None, value: Any) -> bytes:
    """Return the payload of a reply."""
    packed: bytes = msgpack.packb((code, value))
    return packed


def decode_reply(payload: bytes | memoryview) -> tuple[str | None, Any]:
    """Return ``code, value`` of a reply; a long binary value is a view of the payload, not a copy."""
    if payload[:3] == LONG_VALUE:
        return None, memoryview(payload)[len(LONG_VALUE) + 4 :]
    try:
        code, value = msgpack.unpackb(payload, strict_map_key=False)
    except ValueError as broken:
        raise FramingError("a lane's reply cannot be read") from broken
    return code, value


def begin_parts(part: bytes | memoryview) -> Landing:
    """Return the memory for the payload that this part begins, with the part in it. Raises ValueError, struct.error."""
    (size,) = SIZE.unpack_from(part)
    if not 0 < size <= MAX_MESSAGE_BYTES:
        raise FramingError(f"a payload of {size} bytes")
    landing = Landing(size)
    landing.add(memoryview(part)[SIZE.size :])
    return landing


def framed(call: int, payload: Buffers) -> list[bytes | memoryview]:
    """Return the buffers of one message."""
    return [HEAD.pack(sum(map(len, payload)), call), *payload]


class Splitter:
    """Splits the bytes of a stream into messages."""

    def __init__(self) -> None:
        self._rest = bytearray()

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes | memoryview]]:
        """Yield ``call, payload`` of every message that ``data`` completes. Raises FramingError."""
        if not self._rest and len(data) >= HEAD.size:
            length, call = HEAD.unpack_from(data)
            if length == len(data) - HEAD.size:  # most replies come alone
                yield call, memoryview(data)[HEAD.size :]
                return
        self._rest += data
        at = 0
        while len(self._rest) - at >= HEAD.size:
            length, call = HEAD.unpack_from(self._rest, at)
            if length > MAX_MESSAGE_BYTES:
                raise FramingError(f"a message of {length} bytes")
            end = at + HEAD.size + length
            if len(self._rest) < end:
                break
            if length >= LONG_BYTES and end == len(self._rest):
                # Megabytes are passed on without a copy, which would hold up the event loop.
                whole, self._rest = self._rest, bytearray()
                yield call, memoryview(whole)[at + HEAD.size :]
                return
            payload = bytes(memoryview(self._rest)[at + HEAD.size : end])
            at = end
            yield call, payload
        del self._rest[:at]
