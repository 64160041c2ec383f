"""The bytes that attackers send: HTTP calls, handshakes, WebSocket frames."""

from __future__ import annotations

import base64
import struct
from collections.abc import Callable
from dataclasses import dataclass

MIB = 1 << 20
# As large as a frame may be.
HEAVY_BYTES = 8 * MIB
ELSEWHERE = b"Origin: http://elsewhere.example\r\n"
SNAPSHOT, MSGPACK, JSON = b"application/vnd.mfcmt.snapshot", b"application/msgpack", b"application/json"
TEXT, BINARY, PING, PONG = 1, 2, 9, 10
UNFINISHED = struct.pack(">BBQ", BINARY, 0xFF, 16 * MIB) + bytes(4)
ITEMS = b'{"box":[' + b"1," * 200_000 + b"1]}"
DEEP_MAP = b"\x81\xa3box\xdc\x01\x00" + b"\x91" * 60_000


@dataclass(frozen=True, slots=True)
class Ground:
    """The knowledge of an attacker: the port, a key of its own, sessions of its own, an image and the same made heavy.

    ``past`` is a session with a long trajectory, ``large`` one with a snapshot of megabytes.
    """

    port: int
    key: str
    sessions: list[str]
    past: str
    large: str
    image: bytes
    heavy: bytes


def padded(jpeg: bytes, size: int) -> bytes:
    """Return the image with comments in it, so that it has ``size`` bytes or a little less."""
    comment = b"\xff\xfe\xff\xff" + bytes(0xFFFD)
    return jpeg[:2] + comment * ((size - len(jpeg)) // len(comment)) + jpeg[2:]


Bytes = Callable[[Ground, int], bytes]


def nothing(ground: Ground, number: int) -> bytes:
    """No bytes."""
    return b""


def get(path: str, ground: Ground, number: int, *, key: bool = False, more: bytes = b"") -> bytes:
    """A call without a body; ``{past}``, ``{large}`` and ``{session}`` of ``path`` are filled in."""
    return _head("GET", path, ground, number, key) + more + b"\r\n"


def post(
    path: str, body: bytes | Callable[[Ground], bytes], kind: bytes, ground: Ground, number: int, *, more: bytes = b""
) -> bytes:
    """A call with a body and a key."""
    data = body if isinstance(body, bytes) else body(ground)
    head = b"Content-Type: %s\r\nContent-Length: %d\r\n%s\r\n" % (kind, len(data), more)
    return _head("POST", path, ground, number, True) + head + data


def chunked(ground: Ground, number: int) -> bytes:
    """The head of a body in chunks, with a key."""
    head = b"Content-Type: image/jpeg\r\nTransfer-Encoding: chunked\r\n\r\n"
    return _head("POST", "/v1/sessions/{session}/frames", ground, number, True) + head


def handshake(ground: Ground, number: int, *, key: bool = False, more: bytes = b"", query: str = "") -> bytes:
    """The opening of a stream, with the attacker's key if ``key``."""
    upgrade = (
        b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        b"Sec-WebSocket-Key: " + base64.b64encode(bytes(16)) + b"\r\nSec-WebSocket-Protocol: mfcmt.v1.json\r\n"
    )
    path = f"/v1/sessions/{{session}}/stream?takeover=true{query}"
    return _head("GET", path, ground, number, key) + upgrade + more + b"\r\n"


def frames(opcode: int, payload: bytes, times: int, ground: Ground, number: int, *, fin: bool = True) -> bytes:
    """The same WebSocket frame many times."""
    return frame(opcode, payload, fin=fin) * times


def frame(opcode: int, payload: bytes, *, fin: bool = True) -> bytes:
    """A WebSocket frame with a mask of zeros."""
    first, size = (0x80 if fin else 0) | opcode, len(payload)
    if size < 126:
        return struct.pack(">BB", first, 0x80 | size) + bytes(4) + payload
    if size < 1 << 16:
        return struct.pack(">BBH", first, 0xFE, size) + bytes(4) + payload
    return struct.pack(">BBQ", first, 0xFF, size) + bytes(4) + payload


def fragments(times: int, ground: Ground, number: int) -> bytes:
    """A message that begins and goes on in empty fragments, and never ends."""
    return frame(BINARY, b"", fin=False) + frames(0, b"", times, ground, number, fin=False)


def repeated(data: bytes, times: int, ground: Ground, number: int) -> bytes:
    """The same bytes many times."""
    return data * times


def many_gets(path: str, times: int, ground: Ground, number: int) -> bytes:
    """Calls that do not wait for each other's answer."""
    return get(path, ground, number) * times


def heavy_frames(ground: Ground, number: int) -> bytes:
    """Frames of the largest size."""
    return frame(2, ground.heavy)


def first_frame(ground: Ground) -> bytes:
    """The heavy image and a box, as MessagePack."""
    return b"\x82\xa3box\x94\x10\x10\x20\x20\xa5frame\xc6" + struct.pack(">I", len(ground.heavy)) + ground.heavy


def _head(method: str, path: str, ground: Ground, number: int, key: bool) -> bytes:
    session = ground.sessions[number % len(ground.sessions)]
    line = f"{method} {path.format(past=ground.past, large=ground.large, session=session)} HTTP/1.1\r\n"
    return line.encode() + b"Host: service\r\n" + (f"X-API-Key: {ground.key}\r\n".encode() if key else b"")
