"""Signs snapshots for their owners, and verifies those that clients send in.

Lanes never see a key, and nothing reads the body before its signature is verified.

Version 2, big-endian: ``magic: 6s, version: u16, key: 8s, length: u64, mac: 32s``, then the body. ``key`` names the
secret that it is signed with, so that verifying costs at most one HMAC-SHA256. Version 1, which was written before, is
``magic, version, mac``, then the body; every secret has to be tried.
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
    """The bytes are no snapshot that this service signed for this owner. The text may be shown to clients."""


class SnapshotSigner:
    """Signs with the first of the secrets, and verifies what any of them signed."""

    def __init__(self, secrets: Sequence[bytes]) -> None:
        self._secrets = {_name_of(secret): secret for secret in reversed(secrets)}
        self._first = _name_of(secrets[0])

    def sign(self, owner: str, body: bytes | memoryview) -> bytes:
        """Return ``body`` with a version and a signature for ``owner``."""
        return b"".join((self.head(owner, body), body))

    def head(self, owner: str, body: bytes | memoryview) -> bytes:
        """Return what stands before ``body`` when it is signed for ``owner``."""
        start = _HEAD.pack(MAGIC, VERSION, self._first, len(body), b"")[:-_MAC_BYTES]
        return start + _mac(self._secrets[self._first], (_PURPOSE, start, _with_length(owner), body))

    def verify(self, owner: str, data: bytes | memoryview) -> memoryview:
        """Return the body of a snapshot of ``owner``. Raises BadSignature."""
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
        good = self._is_good_1 if version == 1 else self._is_good
        if not good(owner, data, memoryview(data)[head.size :]):
            raise BadSignature("the signature does not match")
        return memoryview(data)[head.size :]

    def _is_good(self, owner: str, data: bytes | memoryview, body: memoryview) -> bool:
        _, _, name, length, mac = _HEAD.unpack_from(data)
        secret = self._secrets.get(name)
        if secret is None or length != len(body):
            return False
        start = data[: _HEAD.size - _MAC_BYTES]
        return hmac.compare_digest(mac, _mac(secret, (_PURPOSE, start, _with_length(owner), body)))

    def _is_good_1(self, owner: str, data: bytes | memoryview, body: memoryview) -> bool:
        _, version, mac = _HEAD_1.unpack_from(data)
        name = owner.encode()
        signed = (struct.pack(">HH", version, len(name)), name, body)
        matches = [hmac.compare_digest(mac, _mac(secret, signed)) for secret in self._secrets.values()]
        return any(matches)


def _name_of(secret: bytes) -> bytes:
    """Return a name that tells a secret from others, and reveals nothing about it."""
    return hashlib.sha256(_NAME + secret).digest()[:8]


def _with_length(owner: str) -> bytes:
    name = owner.encode()
    return struct.pack(">I", len(name)) + name


def _mac(secret: bytes, parts: Iterable[bytes | memoryview]) -> bytes:
    mac = hmac.new(secret, digestmod=hashlib.sha256)
    for part in parts:
        mac.update(part)
    return mac.digest()
