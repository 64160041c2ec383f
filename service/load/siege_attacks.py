"""What a siege tries: each attack is what its connections send first, and what they pour in behind it."""

from __future__ import annotations

import base64
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

MIB = 1 << 20
# As large as a frame may be.
HEAVY_BYTES = 8 * MIB
ELSEWHERE = b"Origin: http://elsewhere.example\r\n"
SNAPSHOT, MSGPACK, JSON = b"application/vnd.mfcmt.snapshot", b"application/msgpack", b"application/json"


@dataclass(frozen=True, slots=True)
class Ground:
    """What an attacker knows: the port, a key of its own, sessions of its own, an image and the same made heavy.

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
    """The same image with comments that nobody looks at, of ``size`` bytes or a little less."""
    comment = b"\xff\xfe\xff\xff" + bytes(0xFFFD)
    return jpeg[:2] + comment * ((size - len(jpeg)) // len(comment)) + jpeg[2:]


Bytes = Callable[[Ground, int], bytes]


def nothing(ground: Ground, number: int) -> bytes:  # noqa: ARG001
    """No bytes."""
    return b""


@dataclass(frozen=True, slots=True)
class Attack:
    """``opening`` and ``pouring`` are given the ground and the connection's number.

    ``keyed``: by somebody with a key. ``stream``: the opening is a handshake whose answer is waited for.
    ``lockstep``: each pour waits for an answer. ``deaf``: answers are not read. ``again``: who is cut comes back.
    """

    name: str
    connections: int
    opening: Bytes
    pouring: Bytes = nothing
    keyed: bool = False
    stream: bool = False
    lockstep: bool = False
    deaf: bool = False
    again: bool = True


def get(path: str, ground: Ground, number: int, *, key: bool = False, more: bytes = b"") -> bytes:
    """A call without a body; ``{past}``, ``{large}`` and ``{session}`` of ``path`` are filled in."""
    return _head("GET", path, ground, number, key) + more + b"\r\n"


def post(
    path: str, body: Callable[[Ground], bytes], kind: bytes, ground: Ground, number: int, *, more: bytes = b""
) -> bytes:
    """A call with a body and a key."""
    data = body(ground)
    head = b"Content-Type: %s\r\nContent-Length: %d\r\n%s\r\n" % (kind, len(data), more)
    return _head("POST", path, ground, number, True) + head + data


def chunked(ground: Ground, number: int) -> bytes:
    """The head of a body in chunks, with a key."""
    head = b"Content-Type: image/jpeg\r\nTransfer-Encoding: chunked\r\n\r\n"
    return _head("POST", "/v1/sessions/{session}/frames", ground, number, True) + head


def handshake(ground: Ground, number: int, *, key: bool = False, more: bytes = b"", query: str = "") -> bytes:
    """The opening of a stream: of one's own session with ``key``, else of any."""
    upgrade = (
        b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        b"Sec-WebSocket-Key: " + base64.b64encode(bytes(16)) + b"\r\nSec-WebSocket-Protocol: mfcmt.v1.json\r\n"
    )
    path = f"/v1/sessions/{{session}}/stream?takeover=true{query}"
    return _head("GET", path, ground, number, key) + upgrade + more + b"\r\n"


def frames(opcode: int, payload: bytes, times: int, ground: Ground, number: int, *, fin: bool = True) -> bytes:  # noqa: ARG001
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


def repeated(data: bytes, times: int, ground: Ground, number: int) -> bytes:  # noqa: ARG001
    """The same bytes many times."""
    return data * times


def many_gets(path: str, times: int, ground: Ground, number: int) -> bytes:
    """Calls that do not wait for each other's answer."""
    return get(path, ground, number) * times


def heavy_frames(ground: Ground, number: int) -> bytes:  # noqa: ARG001
    """Frames of the largest size."""
    return frame(2, ground.heavy)


def first_frame(ground: Ground) -> bytes:
    """The heavy image and a box, as MessagePack."""
    return b"\x82\xa3box\x94\x10\x10\x20\x20\xa5frame\xc6" + struct.pack(">I", len(ground.heavy)) + ground.heavy


def fixed(data: bytes, ground: Ground) -> bytes:  # noqa: ARG001
    """A body that knows nothing of the ground."""
    return data


def _head(method: str, path: str, ground: Ground, number: int, key: bool) -> bytes:
    session = ground.sessions[number % len(ground.sessions)]
    line = f"{method} {path.format(past=ground.past, large=ground.large, session=session)} HTTP/1.1\r\n"
    return line.encode() + b"Host: service\r\n" + (f"X-API-Key: {ground.key}\r\n".encode() if key else b"")


TEXT, BINARY, PING, PONG = 1, 2, 9, 10
refused = partial(handshake, more=ELSEWHERE)
attached = partial(handshake, key=True)
lossless = partial(handshake, key=True, query="&mode=lossless")
UNFINISHED = struct.pack(">BBQ", BINARY, 0xFF, 16 * MIB) + bytes(4)
ITEMS = b'{"box":[' + b"1," * 200_000 + b"1]}"
DEEP_MAP = b"\x81\xa3box\xdc\x01\x00" + b"\x91" * 60_000

STRANGERS = [
    Attack("pings behind a refused handshake", 4, refused, partial(frames, PING, b"", 10_000), stream=True),
    Attack(
        "unfinished messages behind refused handshakes",
        40,
        refused,
        partial(repeated, UNFINISHED + bytes(MIB), 1),
        stream=True,
    ),
    Attack("refused handshakes", 16, refused, stream=True),
    Attack("handshakes without a key", 16, handshake, stream=True),
    Attack(
        "handshakes with long lists of protocols",
        8,
        partial(handshake, more=(b"Sec-WebSocket-Protocol: " + b"a," * 3900 + b"a\r\n") * 3),
        stream=True,
    ),
    Attack(
        "calls without a key",
        32,
        partial(get, "/v1/sessions"),
        partial(get, "/v1/sessions"),
        lockstep=True,
    ),
    Attack("calls that do not wait for answers", 8, nothing, partial(many_gets, "/livez", 2000)),
    Attack("calls whose answers are not read", 40, nothing, partial(many_gets, "/livez", 2000), deaf=True),
    Attack("probes in lockstep", 16, partial(get, "/livez"), partial(get, "/livez"), lockstep=True),
    Attack("metrics in lockstep", 8, partial(get, "/metrics"), partial(get, "/metrics"), lockstep=True),
    Attack("documents that are not read", 100, nothing, partial(many_gets, "/openapi.json", 5), deaf=True),
    Attack("heads that never end", 100, partial(repeated, b"GET / HTTP/1.1\r\nX: ", 1), partial(repeated, b"a", 65536)),
    Attack(
        "heads of small headers", 50, partial(repeated, b"GET / HTTP/1.1\r\n", 1), partial(repeated, b"a:\r\n", 16384)
    ),
    Attack("long request lines", 50, nothing, partial(repeated, b"GET /?" + b"a&" * 100_000, 1)),
    Attack("empty lines", 16, nothing, partial(repeated, b"\r\n", 65536)),
    Attack("bytes that are no call", 16, partial(repeated, b"\x00" * 100, 1)),
    Attack(
        "bodies without a key",
        16,
        partial(get, "/v1/sessions", more=b"Content-Length: 999999999\r\n"),
        partial(repeated, bytes(65536), 4),
    ),
    Attack("connections that are closed at once", 64, nothing),
]
KEYED = [
    Attack("pings on a stream", 4, attached, partial(frames, PING, b"", 10_000), keyed=True, stream=True),
    Attack("pongs that nobody asked for", 4, attached, partial(frames, PONG, b"", 10_000), keyed=True, stream=True),
    Attack(
        "a message in empty fragments",
        4,
        attached,
        lambda g, n: frame(2, b"", fin=False) + frames(0, b"", 10_000, g, n, fin=False),
        keyed=True,
        stream=True,
    ),
    Attack("messages of three bytes", 8, attached, partial(frames, BINARY, b"abc", 4000), keyed=True, stream=True),
    Attack(
        "controls of an unknown type",
        8,
        attached,
        partial(frames, TEXT, b'{"type":"x"}', 2000),
        keyed=True,
        stream=True,
    ),
    Attack(
        "metas without a frame",
        8,
        attached,
        partial(frames, TEXT, b'{"type":"meta","seq":1}', 2000),
        keyed=True,
        stream=True,
    ),
    Attack(
        "controls for a target that is not there",
        8,
        attached,
        partial(frames, TEXT, b'{"type":"remove","target":99}', 1000),
        keyed=True,
        stream=True,
    ),
    Attack(
        "answers that are not read",
        8,
        attached,
        partial(frames, TEXT, b'{"type":"x"}', 100),
        keyed=True,
        stream=True,
        deaf=True,
    ),
    Attack(
        "unfinished messages on streams",
        14,
        attached,
        partial(repeated, UNFINISHED + bytes(MIB), 1),
        keyed=True,
        stream=True,
    ),
    Attack("the largest frames on lossless streams", 14, lossless, heavy_frames, keyed=True, stream=True),
    Attack("streams that take over from each other", 8, attached, keyed=True, stream=True),
    Attack(
        "calls of a key",
        32,
        partial(get, "/v1/sessions", key=True),
        partial(get, "/v1/sessions", key=True),
        keyed=True,
        lockstep=True,
    ),
    Attack("a body in chunks of one byte", 8, chunked, partial(repeated, b"1\r\na\r\n", 10_000), keyed=True),
    Attack(
        "JSON of many items",
        8,
        partial(post, "/v1/sessions", partial(fixed, ITEMS), JSON),
        partial(post, "/v1/sessions", partial(fixed, ITEMS), JSON),
        keyed=True,
        lockstep=True,
    ),
    Attack(
        "MessagePack of many levels",
        8,
        partial(post, "/v1/sessions", partial(fixed, DEEP_MAP), MSGPACK),
        partial(post, "/v1/sessions", partial(fixed, DEEP_MAP), MSGPACK),
        keyed=True,
        lockstep=True,
    ),
    Attack(
        "long past of a session, many at once",
        12,
        partial(get, "/v1/sessions/{past}/trajectory", key=True),
        partial(get, "/v1/sessions/{past}/trajectory", key=True),
        keyed=True,
        lockstep=True,
    ),
    Attack(
        "snapshots that are not read",
        40,
        partial(get, "/v1/sessions/{large}/snapshot", key=True),
        keyed=True,
        deaf=True,
        again=False,
    ),
    Attack(
        "snapshots that nobody signed",
        6,
        partial(post, "/v1/sessions", partial(fixed, bytes(60 * MIB)), SNAPSHOT),
        keyed=True,
        lockstep=True,
    ),
    Attack(
        "one Idempotency-Key many times",
        40,
        partial(post, "/v1/sessions", first_frame, MSGPACK, more=b"Idempotency-Key: siege\r\n"),
        keyed=True,
        lockstep=True,
        again=False,
    ),
]
ATTACKS = STRANGERS + KEYED
