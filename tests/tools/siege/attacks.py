"""The attacks of a siege: what each connection sends first, and what it keeps sending."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from .traffic import (
    BINARY,
    DEEP_MAP,
    ELSEWHERE,
    ITEMS,
    JSON,
    MIB,
    MSGPACK,
    PING,
    PONG,
    SNAPSHOT,
    TEXT,
    UNFINISHED,
    Bytes,
    chunked,
    first_frame,
    fragments,
    frames,
    get,
    handshake,
    heavy_frames,
    many_gets,
    nothing,
    post,
    repeated,
)


@dataclass(frozen=True, slots=True)
class Attack:
    """One attack: ``opening`` and ``pouring`` make bytes from the ground and the connection's number.

    Attributes
    ----------
    keyed : the attacker has a key.
    stream : the opening is a handshake, whose answer is awaited.
    lockstep : each pour waits for an answer.
    deaf : answers are not read.
    again : a connection that was cut is opened again.
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


def handshakes(name: str, connections: int, opening: Bytes, pouring: Bytes = nothing) -> Attack:
    """Return an attack by strangers that open WebSockets."""
    return Attack(name, connections, opening, pouring, stream=True)


def streams(name: str, connections: int, pouring: Bytes = nothing, opening: Bytes | None = None, **more: Any) -> Attack:
    """Return an attack on streams of the attacker's own sessions."""
    return Attack(name, connections, opening or partial(handshake, key=True), pouring, keyed=True, stream=True, **more)


def calls(name: str, connections: int, call: Bytes, **more: Any) -> Attack:
    """Return an attack that makes the same call again as soon as it was answered."""
    return Attack(name, connections, call, call, lockstep=True, **more)


refused = partial(handshake, more=ELSEWHERE)
lossless = partial(handshake, key=True, query="&mode=lossless")
unfinished = partial(repeated, UNFINISHED + bytes(MIB), 1)
long_lists = partial(handshake, more=(b"Sec-WebSocket-Protocol: " + b"a," * 3900 + b"a\r\n") * 3)

STRANGERS = [
    handshakes("pings behind a refused handshake", 4, refused, partial(frames, PING, b"", 10_000)),
    handshakes("unfinished messages behind refused handshakes", 40, refused, unfinished),
    handshakes("refused handshakes", 16, refused),
    handshakes("handshakes without a key", 16, handshake),
    handshakes("handshakes with long lists of protocols", 8, long_lists),
    calls("calls without a key", 32, partial(get, "/v1/sessions")),
    Attack("calls that do not wait for answers", 8, nothing, partial(many_gets, "/livez", 2000)),
    Attack("calls whose answers are not read", 40, nothing, partial(many_gets, "/livez", 2000), deaf=True),
    calls("probes in lockstep", 16, partial(get, "/livez")),
    calls("metrics in lockstep", 8, partial(get, "/metrics")),
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
    streams("pings on a stream", 4, partial(frames, PING, b"", 10_000)),
    streams("pongs that nobody asked for", 4, partial(frames, PONG, b"", 10_000)),
    streams("a message in empty fragments", 4, partial(fragments, 10_000)),
    streams("messages of three bytes", 8, partial(frames, BINARY, b"abc", 4000)),
    streams("controls of an unknown type", 8, partial(frames, TEXT, b'{"type":"x"}', 2000)),
    streams("metas without a frame", 8, partial(frames, TEXT, b'{"type":"meta","seq":1}', 2000)),
    streams(
        "controls for a target that is not there", 8, partial(frames, TEXT, b'{"type":"remove","target":99}', 1000)
    ),
    streams("answers that are not read", 8, partial(frames, TEXT, b'{"type":"x"}', 100), deaf=True),
    streams("unfinished messages on streams", 14, unfinished),
    streams("the largest frames on lossless streams", 14, heavy_frames, lossless),
    streams("streams that take over from each other", 8),
    calls("calls of a key", 32, partial(get, "/v1/sessions", key=True), keyed=True),
    Attack("a body in chunks of one byte", 8, chunked, partial(repeated, b"1\r\na\r\n", 10_000), keyed=True),
    calls("JSON of many items", 8, partial(post, "/v1/sessions", ITEMS, JSON), keyed=True),
    calls("MessagePack of many levels", 8, partial(post, "/v1/sessions", DEEP_MAP, MSGPACK), keyed=True),
    calls(
        "long past of a session, many at once", 12, partial(get, "/v1/sessions/{past}/trajectory", key=True), keyed=True
    ),
    Attack(
        "snapshots that are not read",
        40,
        partial(get, "/v1/sessions/{large}/snapshot", key=True),
        keyed=True,
        deaf=True,
        again=False,
    ),
    Attack("snapshots that nobody signed", 6, partial(post, "/v1/sessions", bytes(60 * MIB), SNAPSHOT), keyed=True),
    Attack(
        "one Idempotency-Key many times",
        40,
        partial(post, "/v1/sessions", first_frame, MSGPACK, more=b"Idempotency-Key: siege\r\n"),
        keyed=True,
        again=False,
    ),
]
ATTACKS = STRANGERS + KEYED
