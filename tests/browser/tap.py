"""A cable that remembers what went through it, and the messages in there."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import msgpack

from tests.service.live.cable import Cable

TEXT, BINARY = 1, 2


@dataclass
class Direction:
    """One direction of one connection."""

    data: bytearray = field(default_factory=bytearray)


class _Heard:
    def __init__(self, reader: asyncio.StreamReader, direction: Direction) -> None:
        self._reader, self._direction = reader, direction

    async def read(self, most: int) -> bytes:
        data = await self._reader.read(most)
        self._direction.data += data
        return data


class Tap(Cable):
    """``directions`` come in pairs, up and down."""

    def __init__(self, port: int) -> None:
        super().__init__(port)
        self.directions: list[Direction] = []

    async def _carry(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        direction = Direction()
        self.directions.append(direction)
        await super()._carry(_Heard(source, direction), sink)  # type: ignore[arg-type]

    def streams(self) -> list[tuple[list[Any], list[Any]]]:
        """The messages of each WebSocket, sent and received: bytes, or what JSON says."""
        pairs = [(up.data, down.data) for up, down in zip(self.directions[::2], self.directions[1::2], strict=True)]
        return [(list(_messages(up)), list(_messages(down))) for up, down in pairs if b"/stream" in up[:200]]

    def created(self) -> tuple[bytes, list[list[float]]]:
        """The image and the boxes that the newest session was created with."""
        body = msgpack.unpackb([body for up in self.directions[::2] for body in _posted(bytes(up.data))][-1])
        return body["frame"], body["boxes"]


def _posted(data: bytes) -> Iterator[bytes]:
    """Bodies of ``POST /v1/sessions`` in a connection."""
    at = 0
    while (at := data.find(b"POST /v1/sessions HTTP/1.1\r\n", at)) >= 0:
        head, _, rest = data[at:].partition(b"\r\n\r\n")
        length = next(line for line in head.split(b"\r\n") if line.lower().startswith(b"content-length:"))
        yield rest[: int(length.split(b":")[1])]
        at += len(head)


def _messages(data: bytes | bytearray) -> Iterator[Any]:
    """Frames of RFC 6455 behind the handshake; browsers and our server do not fragment what we look for."""
    data = bytes(data)
    at = data.find(b"\r\n\r\n") + 4
    whole, kind = b"", TEXT
    while at + 2 <= len(data):
        first, second = data[at], data[at + 1]
        length, at = second & 127, at + 2
        if length > 125:
            size = 2 if length == 126 else 8
            length, at = int.from_bytes(data[at : at + size], "big"), at + size
        mask = b""
        if second & 128:
            mask, at = data[at : at + 4], at + 4
        payload, at = data[at : at + length], at + length
        if len(payload) < length:
            return
        if mask:
            key = (mask * (length // 4 + 1))[:length]
            payload = (int.from_bytes(payload, "big") ^ int.from_bytes(key, "big")).to_bytes(length, "big")
        if first & 15 in (0, TEXT, BINARY):
            kind = first & 15 or kind
            whole += payload
            if first & 128:
                yield json.loads(whole) if kind == TEXT else whole
                whole = b""
