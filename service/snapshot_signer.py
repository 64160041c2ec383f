"""Snapshots on their way out and in: a version, a signature bound to the owner, and the lane's bytes untouched.

The lanes never see a key, and nothing looks into the bytes before their signature is found good.

Version 2, big-endian: ``magic: 6s, version: u16, key: 8s, length: u64, mac: 32s`` and the body. ``key`` tells
by which of the secrets it is signed, so that what is sent in costs one HMAC-SHA256 at most. Version 1, which
was written before, is ``magic, version, mac`` and the body; its secret has to be tried out.
"""

from __future__ import annotations

import hashlib
import hmac
import struct
from collections.abc import Iterable, Sequence

MAGIC = b"MFCMTS"
VERSION = 2
READABLE = (1, 2)
_START = struct.Struct(">6sH")
_MAC_BYTES = hashlib.sha256().digest_size
_HEAD = struct.Struct(f">6sH8sQ{_MAC_BYTES}s")
_HEAD_1 = struct.Struct(f">6sH{_MAC_BYTES}s")
_PURPOSE, _NAME = b"mfcmt snapshot\0", b"mfcmt signing key\0"


class BadSignature(Exception):
    """The bytes are no snapshot that this service signed for this owner; the text may be shown."""


class SnapshotSigner:
    """Signs with the first secret, reads what any of them signed."""

    def __init__(self, secrets: Sequence[bytes]) -> None:
        self._secrets = {_name(secret): secret for secret in reversed(secrets)}
        self._first = _name(secrets[0])

    def sign(self, owner: str, body: bytes | memoryview) -> bytes:
        """``body`` versioned and signed for ``owner``."""
        start = _HEAD.pack(MAGIC, VERSION, self._first, len(body), b"")[:-_MAC_BYTES]
        mac = _mac(self._secrets[self._first], (_PURPOSE, start, _sized(owner), body))
        return b"".join((start, mac, body))

    def verify(self, owner: str, data: bytes) -> bytes:
        """The body, if its signature is good. Raises BadSignature."""
        if len(data) < _START.size:
            raise BadSignature("shorter than a snapshot's head")
        magic, version = _START.unpack_from(data)
        if magic != MAGIC:
            raise BadSignature("not a snapshot")
        if version not in READABLE:
            raise BadSignature(f"version {version} is not read here")
        head = _HEAD_1 if version == 1 else _HEAD
        if len(data) < head.size:
            raise BadSignature("shorter than a snapshot's head")
        good = self._good_1 if version == 1 else self._good
        if not good(owner, data, memoryview(data)[head.size :]):
            raise BadSignature("the signature does not match")
        return data[head.size :]

    def _good(self, owner: str, data: bytes, body: memoryview) -> bool:
        _, _, name, length, mac = _HEAD.unpack_from(data)
        secret = self._secrets.get(name)
        if secret is None or length != len(body):
            return False
        start = data[: _HEAD.size - _MAC_BYTES]
        return hmac.compare_digest(mac, _mac(secret, (_PURPOSE, start, _sized(owner), body)))

    def _good_1(self, owner: str, data: bytes, body: memoryview) -> bool:
        _, version, mac = _HEAD_1.unpack_from(data)
        name = owner.encode()
        signed = (struct.pack(">HH", version, len(name)), name, body)
        matches = [hmac.compare_digest(mac, _mac(secret, signed)) for secret in self._secrets.values()]
        return any(matches)


def _name(secret: bytes) -> bytes:
    """What tells a secret from others, and nothing about it."""
    return hashlib.sha256(_NAME + secret).digest()[:8]


def _sized(owner: str) -> bytes:
    name = owner.encode()
    return struct.pack(">I", len(name)) + name


def _mac(secret: bytes, parts: Iterable[bytes | memoryview]) -> bytes:
    mac = hmac.new(secret, digestmod=hashlib.sha256)
    for part in parts:
        mac.update(part)
    return mac.digest()
