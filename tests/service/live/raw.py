"""The protocol by hand, for what a well-behaved client would never send."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import msgpack
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from service.load.own import OwnServer

PATIENCE_S = 20.0
MSGPACK, JSON = "mfcmt.v1.msgpack", "mfcmt.v1.json"


class Raw:
    """A WebSocket and its subprotocol."""

    def __init__(self, socket: ClientConnection, protocol: str) -> None:
        self.socket = socket
        self.binary = protocol == MSGPACK

    async def frame(self, data: bytes, **beside: Any) -> None:
        """A frame message."""
        if self.binary:
            await self.send({"type": "frame", "frame": data, **beside})
            return
        if beside:
            await self.send({"type": "meta", **beside})
        await self.socket.send(data)

    async def send(self, message: Any) -> None:
        """Any value, as the subprotocol writes it."""
        await self.socket.send(msgpack.packb(message) if self.binary else json.dumps(message))

    async def receive(self) -> dict[str, Any]:
        async with asyncio.timeout(PATIENCE_S):
            data = await self.socket.recv()
        assert isinstance(data, bytes) == self.binary
        said: dict[str, Any] = msgpack.unpackb(data) if isinstance(data, bytes) else json.loads(data)
        return said

    async def problem(self) -> dict[str, Any]:
        """The problem of the next message, which is an error."""
        said = await self.receive()
        assert said["type"] == "error", said
        problem: dict[str, Any] = said["problem"]
        assert {"type", "title", "status", "code"} <= set(problem)
        return problem | {"seq": said.get("seq"), "ref": said.get("ref")}

    async def closed(self) -> int:
        """The code with which the server closes; what comes before is read and forgotten."""
        try:
            async with asyncio.timeout(PATIENCE_S):
                while True:
                    await self.socket.recv()
        except ConnectionClosed as end:
            return end.rcvd.code if end.rcvd else 1006


@asynccontextmanager
async def attach(
    server: OwnServer,
    session_id: str,
    *,
    protocol: str = MSGPACK,
    headers: dict[str, str] | None = None,
    ready: bool = True,
    subprotocols: list[str] | None = None,
    **query: str,
) -> AsyncIterator[Raw]:
    """A stream of the session, after its ``ready``."""
    options = "&".join(f"{name}={value}" for name, value in ({"mode": "lossless"} | query).items())
    url = f"ws{server.url[4:]}/v1/sessions/{session_id}/stream?{options}"
    async with connect(
        url,
        subprotocols=subprotocols or [protocol],  # type: ignore[arg-type]
        additional_headers=headers,
        compression=None,
        max_size=None,
    ) as socket:
        raw = Raw(socket, protocol)
        if ready:
            assert (await raw.receive())["type"] == "ready"
        yield raw
