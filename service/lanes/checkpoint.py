"""A session's state as the service keeps it for itself: a version and MessagePack.

It is not signed, because it never leaves the service; what a client is given is sealed (``seal``).
"""

from __future__ import annotations

import struct
from typing import Any

import msgpack

MAGIC = b"MFCMTC"
HEAD = struct.Struct(">6sH")
VERSION = 1
READABLE = (1,)


class BadCheckpoint(Exception):
    """The bytes are no checkpoint, or of a version that is not read here."""


def pack(contents: dict[str, Any]) -> bytes:
    """``contents`` as bytes that :func:`unpack` reads."""
    body: bytes = msgpack.packb(contents)
    return HEAD.pack(MAGIC, VERSION) + body


def unpack(data: bytes) -> dict[str, Any]:
    """The contents. Raises BadCheckpoint, and ValueError for MessagePack that is broken."""
    if len(data) < HEAD.size:
        raise BadCheckpoint("shorter than a checkpoint's head")
    magic, version = HEAD.unpack_from(data)
    if magic != MAGIC or version not in READABLE:
        raise BadCheckpoint(f"version {version} is not read here")
    contents: dict[str, Any] = msgpack.unpackb(memoryview(data)[HEAD.size :])
    return contents
