"""Connections as the server's parsers hand them over, on real sockets and with an application of three lines."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
import websockets
from uvicorn.config import Config
from uvicorn.server import ServerState

from service import turns
from service.connections import protocols
from service.sessions.byte_budget import ByteBudget
from service.settings import Settings


async def _echo(scope: Any, receive: Any, send: Any) -> None:
    assert (await receive())["type"] == "websocket.connect"
    await send({"type": "websocket.accept"})
    while (message := await receive())["type"] == "websocket.receive":
        await send({"type": "websocket.send", "text": message["text"]})


async def test_a_stream_whose_handshake_waited_for_its_turn_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    waits = iter([True])
    monkeypatch.setattr(turns, "must_wait", lambda *_: next(waits, False))
    calls, frames = protocols(Settings(), ByteBudget(1 << 20))
    config = Config(_echo, http=calls, ws=frames, lifespan="off")
    config.load()
    loop, state = asyncio.get_running_loop(), ServerState()
    server = await loop.create_server(lambda: calls(config, state, {}), "127.0.0.1", 0)
    async with server, asyncio.timeout(10):
        port = server.sockets[0].getsockname()[1]
        async with websockets.connect(f"ws://127.0.0.1:{port}/") as client:
            await client.send("a frame")
            assert await client.recv() == "a frame"
    assert next(waits, None) is None
