"""``mfcmt serve --nodes``: several nodes by one command."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys

import httpx2
import pytest

from service.cli.serve_nodes import SERVE
from service.client import AsyncClient
from service.load.clips import Clip
from service.load.own import free_port
from tests.commands import run_command

from .redis_server import RedisServer


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "--nodes needs MFCMT_STORE"),
        ({"MFCMT_STORE": "redis://127.0.0.1:1", "MFCMT_PORT": "0"}, "free ports"),
        (
            {"MFCMT_STORE": "redis://127.0.0.1:1", "MFCMT_HOST": "0.0.0.0", "MFCMT_ALLOW_UNAUTHENTICATED": "true"},
            "--nodes needs MFCMT_NODE_URL",
        ),
        ({"MFCMT_STORE": "redis://127.0.0.1:1", "MFCMT_LANES": "none"}, "MFCMT_LANES"),
    ],
)
def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, given: dict[str, str], said: str) -> None:
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    refused = run_command("serve", "--nodes", 2)
    assert refused.returncode == 2
    assert said in refused.stderr


def test_a_store_that_does_not_answer_ends_the_start() -> None:
    given = {"STORE": f"redis://127.0.0.1:{free_port()}", "NODE": "a", "NODE_URL": "http://127.0.0.1:8000"}
    environment = os.environ | {f"MFCMT_{name}": value for name, value in given.items()}
    ended = subprocess.run(
        [sys.executable, "-c", SERVE],
        env=environment | {"MFCMT_PORT": str(free_port())},
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 1
    assert "MFCMT_STORE: Redis cannot be used" in ended.stderr
    assert "Traceback" not in ended.stderr


async def test_both_nodes_serve_and_stop_together(redis_server: RedisServer, clip: Clip) -> None:
    port = free_port()
    given = {"STORE": redis_server.url, "PORT": str(port), "NODE": "m", "LANES": "2", "OPERATION_DEADLINE_S": "60"}
    environment = os.environ | {f"MFCMT_{name}": value for name, value in given.items()}
    program = SERVE.replace("['serve']", "['serve', '--nodes', '2']")
    with subprocess.Popen([sys.executable, "-c", program], env=environment) as both:
        try:
            urls = [f"http://127.0.0.1:{port + index}" for index in range(2)]
            for url in urls:
                await ready(url)
            async with AsyncClient(urls[0]) as client, AsyncClient(urls[1]) as other:
                session = await client.create(clip.frames[0], clip.box)
                assert session.id.startswith("m-0.")
                assert (await (await other.session(session.id)).track(clip.frames[1])).seq == 1
        finally:
            both.send_signal(signal.SIGTERM)
        assert await asyncio.to_thread(both.wait) == 0


async def ready(url: str) -> None:
    """Wait until a node is ready."""
    async with httpx2.AsyncClient(base_url=url) as bare:
        while True:
            try:
                if (await bare.get("/readyz")).status_code == 200:
                    return
            except httpx2.TransportError:
                pass
            await asyncio.sleep(0.05)
