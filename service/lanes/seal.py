"""Snapshots on their way out and in: a version, a signature bound to the owner, and MessagePack."""

from __future__ import annotations

import hashlib
import hmac
import struct
from collections.abc import Sequence
from typing import Any

import msgpack

MAGIC = b"MFCMTS"
HEAD = struct.Struct(">6sH32s")
VERSION = 1
READABLE = (1,)


class BadSeal(Exception):
    """The bytes are no snapshot that this service signed for this owner; the text may be shown."""


class Seal:
    """Signs with the first key, reads what any of them signed."""

    def __init__(self, keys: Sequence[bytes]) -> None:
        self._keys = list(keys)

    def close(self, owner: str, contents: dict[str, Any]) -> bytes:
        """``contents`` packed, versioned and signed for ``owner``."""
        body: bytes = msgpack.packb(contents)
        return HEAD.pack(MAGIC, VERSION, _mac(self._keys[0], VERSION, owner, body)) + body

    def open(self, owner: str, data: bytes) -> dict[str, Any]:
        """The contents, looked at only after the signature is found good. Raises BadSeal."""
        if len(data) < HEAD.size:
            raise BadSeal("shorter than a snapshot's head")
        magic, version, mac = HEAD.unpack_from(data)
        if magic != MAGIC:
            raise BadSeal("not a snapshot")
        if version not in READABLE:
            raise BadSeal(f"version {version} is not read here")
        body = memoryview(data)[HEAD.size :]
        if not any(hmac.compare_digest(mac, _mac(key, version, owner, body)) for key in self._keys):
            raise BadSeal("the signature does not match")
        contents: dict[str, Any] = msgpack.unpackb(body)
        return contents


def _mac(key: bytes, version: int, owner: str, body: bytes | memoryview) -> bytes:
    name = owner.encode()
    mac = hmac.new(key, struct.pack(">HH", version, len(name)) + name, hashlib.sha256)
    mac.update(body)
    return mac.digest()
