"""Faults of ours: told with the request id and without a word of what went on; everything else goes on."""

from __future__ import annotations

import asyncio
import base64
import json
from collections.abc import AsyncIterator
from typing import Any

import httpx2
import pytest
from starlette.testclient import TestClient

from service.app import create_app
from service.lanes.framing import encode_reply
from service.lanes.interface import Buffers
from service.settings import Settings

from .test_registry import Lanes

SECRET = "Traceback (most recent call last): secret"
JPEG = b"\xff\xd8\xff\xe0" + bytes(40)


class FaultyLanes(Lanes):
    """Lanes that can be told to fail in ways of their own."""

    fault: bytes | Exception | None = None

    async def call(self, key: str, request: Buffers) -> bytes:
        if isinstance(self.fault, Exception):
            raise self.fault
        return self.fault or await super().call(key, request)


@pytest.fixture
def lanes() -> FaultyLanes:
    return FaultyLanes(4)


@pytest.fixture
async def http(lanes: FaultyLanes) -> AsyncIterator[httpx2.AsyncClient]:
    transport = httpx2.ASGITransport(create_app(Settings(), lanes=lanes))
    async with httpx2.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
        yield client


async def create(http: httpx2.AsyncClient) -> httpx2.Response:
    body = {"frame": base64.b64encode(JPEG).decode(), "box": [1, 2, 3, 4]}
    return await http.post("/v1/sessions", json=body, headers={"X-Request-ID": "mine-1"})


@pytest.mark.parametrize("fault", [encode_reply("internal", [SECRET, {}]), b"\xc1", RuntimeError(SECRET)])
async def test_a_fault_over_http(http: httpx2.AsyncClient, lanes: FaultyLanes, fault: Any) -> None:
    lanes.fault = fault
    response = await create(http)
    assert response.status_code == 500
    assert response.headers["X-Request-ID"] == "mine-1"
    answer = response.json()
    assert (answer["code"], answer["request_id"]) == ("internal", "mine-1")
    assert "secret" not in response.text
    assert not lanes.keys
    lanes.fault = None
    assert (await create(http)).status_code == 201


def test_a_fault_in_a_stream(lanes: FaultyLanes) -> None:
    with TestClient(create_app(Settings(), lanes=lanes), base_url="http://127.0.0.1") as client:
        body = {"frame": base64.b64encode(JPEG).decode(), "box": [1, 2, 3, 4]}
        sid = client.post("/v1/sessions", json=body).json()["id"]
        url = f"/v1/sessions/{sid}/stream?mode=lossless"
        with client.websocket_connect(url, headers={"X-Request-ID": "mine-2", "Host": "127.0.0.1"}) as socket:
            assert json.loads(socket.receive_text())["type"] == "ready"
            lanes.fault = encode_reply("internal", [SECRET, {}])
            socket.send_bytes(JPEG)
            answer = json.loads(socket.receive_text())
            assert (answer["type"], answer["seq"]) == ("error", 1)
            assert (answer["problem"]["code"], answer["problem"]["request_id"]) == ("internal", "mine-2")
            assert "secret" not in str(answer)
            lanes.fault = None
            socket.send_bytes(JPEG)
            assert json.loads(socket.receive_text())["type"] == "result"
            lanes.fault = RuntimeError(SECRET)
            socket.send_bytes(JPEG)
            closed = socket.receive()
            assert (closed["type"], closed["code"]) == ("websocket.close", 1011)


async def test_a_slow_body_has_its_time(lanes: FaultyLanes) -> None:
    app = create_app(Settings(body_timeout_s=0.05), lanes=lanes)
    transport = httpx2.ASGITransport(app)

    async def slowly() -> AsyncIterator[bytes]:
        yield b"{"
        await asyncio.sleep(10)

    async with httpx2.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
        headers = {"Content-Type": "application/json"}
        response = await client.post("/v1/sessions", content=slowly(), headers=headers)
    assert (response.status_code, response.json()["code"]) == (504, "deadline-exceeded")
