"""A real server and the bare wire: no client of ours, so that what is tested is the protocol itself."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, Self

import httpx2
import msgpack
import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from service.load.own import OwnServer

Serve = Callable[..., "Wire"]
Answer = dict[str, Any]


def problem(response: httpx2.Response) -> tuple[int, str]:
    """The status and the code of a refusal."""
    assert response.headers["content-type"] == "application/problem+json"
    body = response.json()
    assert body["status"] == response.status_code
    assert body["type"] == f"/docs#{body['code']}"
    return response.status_code, body["code"]


class Stream:
    """A WebSocket and the subprotocol that it speaks."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.binary = socket.subprotocol == "mfcmt.v1.msgpack"
        self.ready: Answer = {}

    async def frame(self, data: bytes, **meta: Any) -> None:
        if self.binary:
            await self.socket.send(msgpack.packb({"type": "frame", "frame": data, **meta}))
            return
        if meta:
            await self.say(type="meta", **meta)
        await self.socket.send(data)

    async def say(self, **message: Any) -> None:
        await self.socket.send(msgpack.packb(message) if self.binary else json.dumps(message))

    async def hear(self, kind: str | None = None) -> Answer:
        data = await self.socket.recv()
        message: Answer = msgpack.unpackb(data) if isinstance(data, bytes) else json.loads(data)
        assert kind in (None, message["type"]), message
        return message

    async def refused(self) -> str:
        """The code of the error that is heard."""
        code: str = (await self.hear("error"))["problem"]["code"]
        return code

    async def closed(self) -> int:
        """The close code, whatever is said before it."""
        try:
            while True:
                await asyncio.wait_for(self.socket.recv(), 15)
        except ConnectionClosed as end:
            return end.rcvd.code if end.rcvd else 1006


class Wire:
    """Calls and streams of one server."""

    def __init__(self, server: OwnServer, headers: dict[str, str] | None = None) -> None:
        self.server = server
        self.headers = headers or {}
        self.http = httpx2.AsyncClient(base_url=server.url, headers=self.headers, timeout=30)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.http.aclose()

    async def create(self, frame: bytes, *boxes: Any, **options: Any) -> Answer:
        response = await self.post(frame, *boxes, **options)
        assert response.status_code == 201, response.text
        answer: Answer = response.json()
        return answer

    async def post(self, frame: bytes, *boxes: Any, headers: Any = None, **options: Any) -> httpx2.Response:
        data = {"boxes": json.dumps([list(box) for box in boxes]), "options": json.dumps(options)}
        return await self.http.post("/v1/sessions", files={"frame": frame}, data=data, headers=headers)

    async def track(self, sid: str, frame: bytes, **params: Any) -> httpx2.Response:
        headers = {"Content-Type": "application/octet-stream"}
        return await self.http.post(f"/v1/sessions/{sid}/frames", content=frame, params=params, headers=headers)

    @asynccontextmanager
    async def stream(
        self, sid: str, *, protocols: Any = ("mfcmt.v1.json",), headers: Any = None, **query: str
    ) -> AsyncIterator[Stream]:
        text = "&".join(f"{name}={value}" for name, value in query.items())
        url = f"ws{self.server.url[4:]}/v1/sessions/{sid}/stream?{text}"
        sent = self.headers | (headers or {})
        async with connect(
            url, subprotocols=list(protocols) or None, additional_headers=sent, compression=None, max_size=None
        ) as socket:
            stream = Stream(socket)
            if "origin" not in {name.lower() for name in sent}:
                stream.ready = await stream.hear("ready")
            yield stream


def reset(writer: asyncio.StreamWriter) -> None:
    """End a connection at once, unless the service has ended it already."""
    if not writer.transport.is_closing():
        writer.transport.abort()


async def under_way_bytes(wire: Wire) -> float:
    """Return how many bytes the service counts as under way."""
    text = (await wire.http.get("/metrics")).text
    return next(float(line.split()[1]) for line in text.splitlines() if line.startswith("mfcmt_under_way_bytes "))


@pytest.fixture
async def wire(server: OwnServer) -> AsyncIterator[Wire]:
    async with Wire(server) as wire:
        yield wire


@pytest.fixture
def serve(own_server: Callable[..., OwnServer]) -> Serve:
    """Servers with settings of their own, ended with the test."""

    def start(headers: dict[str, str] | None = None, **settings: object) -> Wire:
        return Wire(own_server(**settings), headers)

    return start
