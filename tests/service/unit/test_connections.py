"""Connections as the server's parsers hand them over, on real sockets and with an application of three lines."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
import websockets
from uvicorn.config import Config
from uvicorn.server import ServerState
from websockets.frames import Frame, Opcode

from service import turns
from service.connections import protocols
from service.sessions.byte_budget import ByteBudget
from service.settings import Settings

HANDSHAKE = (
    b"GET / HTTP/1.1\r\nHost: here\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


async def _echo(scope: Any, receive: Any, send: Any) -> None:
    assert (await receive())["type"] == "websocket.connect"
    await send({"type": "websocket.accept"})
    while (message := await receive())["type"] == "websocket.receive":
        kind = "text" if message.get("text") is not None else "bytes"
        await send({"type": "websocket.send", kind: message[kind]})


async def test_a_stream_whose_handshake_waited_for_its_turn_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    waits = iter([True])
    monkeypatch.setattr(turns, "must_wait", lambda *_: next(waits, False))
    async with _serving() as port, websockets.connect(f"ws://127.0.0.1:{port}/") as client:
        await client.send("a frame")
        assert await client.recv() == "a frame"
    assert next(waits, None) is None


@pytest.mark.parametrize("piece", [1, 5, 13, 90_000])
async def test_messages_are_read_in_order_in_whatever_pieces_they_arrive(piece: int) -> None:
    """Some take the short way of a message in one frame, some the parser's, and some begin on one and end on both."""
    large = bytes(range(256)) * (8 if piece < 100 else 400)
    sent = [
        Frame(Opcode.BINARY, b"a frame"),
        Frame(Opcode.BINARY, large),
        Frame(Opcode.BINARY, b"a frame in ", fin=False),
        Frame(Opcode.PING, b"meanwhile"),
        Frame(Opcode.CONT, b"parts"),
        Frame(Opcode.BINARY, b""),
        Frame(Opcode.TEXT, b"a text"),
        Frame(Opcode.BINARY, large),
        Frame(Opcode.BINARY, b"the last"),
    ]
    data = b"".join(frame.serialize(mask=True) for frame in sent)
    async with _serving() as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(HANDSHAKE)
        assert b" 101 " in await reader.readuntil(b"\r\n\r\n")
        for at in range(0, len(data), piece):
            writer.write(data[at : at + piece])
            await asyncio.sleep(0)
        binary = (b"a frame", large, b"a frame in parts", b"")
        expected = [(Opcode.BINARY, payload) for payload in binary]
        expected += [(Opcode.TEXT, b"a text"), (Opcode.BINARY, large), (Opcode.BINARY, b"the last")]
        answers: list[tuple[int, bytes]] = []
        while len(answers) < len(expected):
            opcode, payload = await _frame(reader)
            answers += [] if opcode == Opcode.PONG else [(opcode, payload)]
        writer.close()
    assert answers == expected


async def _frame(reader: asyncio.StreamReader) -> tuple[int, bytes]:
    """Return the opcode and the payload of the next frame of the server."""
    first, size = await reader.readexactly(2)
    if size > 125:
        size = int.from_bytes(await reader.readexactly(2 if size == 126 else 8))
    return first & 0x0F, await reader.readexactly(size)


@asynccontextmanager
async def _serving() -> AsyncIterator[int]:
    """Serve the application, and yield the port."""
    calls, frames = protocols(Settings(), ByteBudget(1 << 20))
    config = Config(_echo, http=calls, ws=frames, lifespan="off")
    config.load()
    loop, state = asyncio.get_running_loop(), ServerState()
    server = await loop.create_server(lambda: calls(config, state, {}), "127.0.0.1", 0)
    async with server, asyncio.timeout(10):
        yield server.sockets[0].getsockname()[1]
