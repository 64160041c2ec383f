"""Real HAProxy and nginx with the files of docker/cluster, in front of three real nodes that share a real Redis."""

from __future__ import annotations

import os
import re
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx2
import pytest

from service.client import AsyncClient
from service.load.clips import Clip, sample
from service.load.own import OwnServer, free_port
from tests.conftest import ROOT, require
from tests.programs import nginx_with, running
from tests.service.cluster.nodes import KEY, Run, haproxy, led
from tests.service.cluster.nodes import node as make_node
from tests.service.cluster.redis_server import RedisServer

NAMES = ("node-1", "node-2", "node-3")
HELD, LENGTH = 6, 12


def nginx(folder: Path, port: int, nodes: list[OwnServer]) -> list[str]:
    text = (ROOT / "docker/cluster/nginx.conf").read_text()
    return nginx_with(led(text, nodes).replace("listen 8080", f"listen 127.0.0.1:{port}"), folder)


@pytest.fixture(scope="module")
def clip() -> Clip:
    return sample(LENGTH + 1)


@pytest.fixture(scope="module", params=[haproxy, nginx], ids=["haproxy", "nginx"])
def proxy(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[str, list[OwnServer]]]:
    """The URL of a proxy, and the nodes behind it, which know themselves by its paths."""
    make: Callable[..., list[str]] = request.param
    require(shutil.which(make.__name__), f"no {make.__name__}")
    folder, port = tmp_path_factory.mktemp(make.__name__), free_port()
    url = f"http://127.0.0.1:{port}"
    with RedisServer() as redis:
        nodes = [make_node(name, redis, node_url=f"{url}/{name}") for name in NAMES]
        try:
            for node in nodes:
                node.start()
            with running(make(folder, port, nodes), folder, lambda: ready(url)):
                yield url, nodes
        finally:
            for node in nodes:
                node.stop()


def ready(url: str) -> bool:
    try:
        return all(httpx2.get(f"{url}/{name}/readyz").status_code == 200 for name in NAMES)
    except httpx2.TransportError:
        return False


def handshakes(node: OwnServer) -> int:
    return node.log.count("stream attached")


async def test_calls_and_streams_go_to_the_node_that_the_session_or_the_path_names(
    proxy: tuple[str, list[OwnServer]], clip: Clip
) -> None:
    url, nodes = proxy
    async with AsyncClient(url, key=KEY) as client, httpx2.AsyncClient(headers={"X-API-Key": KEY}) as bare:
        session = await client.create(clip.frames[0], clip.box)
        name = session.id.partition(".")[0]
        owner = nodes[NAMES.index(name)]
        assert session.info.stream_url == f"{url.replace('http', 'ws')}/{name}/v1/sessions/{session.id}/stream"
        before = [handshakes(node) for node in nodes]
        seen = [result.seq async for result in session.stream(clip.frames[1:], mode="lossless")]
        assert seen == list(range(1, LENGTH + 1))
        assert [handshakes(node) - count for node, count in zip(nodes, before, strict=True)] == [
            int(node is owner) for node in nodes
        ]
        # by the session's id alone, what other nodes would redirect is answered at once
        for place in (f"{url}/v1/sessions/{session.id}", f"{url}/{name}/v1/sessions/{session.id}"):
            assert (await bare.get(f"{place}/trajectory")).status_code == 200
        for path in ("/metrics", f"/{name}/metrics"):
            assert (await bare.get(url + path)).status_code == 404
        await session.close()


async def test_a_stream_goes_on_at_another_node_when_its_own_is_killed(
    proxy: tuple[str, list[OwnServer]], clip: Clip
) -> None:
    """The last test of a proxy: one of its nodes is gone after it."""
    url, nodes = proxy
    async with AsyncClient(url, key=KEY) as client:
        session = await client.create(clip.frames[0], clip.box)
        run = Run(session, clip.frames[1:], HELD)
        await run.halfway.wait()
        os.kill(nodes[NAMES.index(session.id.partition(".")[0])].pid, signal.SIGKILL)
        numbers = await run.finish()
        assert len(set(numbers)) == len(numbers) == LENGTH
        assert len(run.resumed) == 1
        await session.close()


def test_both_files_name_the_same_nodes() -> None:
    for name in ("haproxy.cfg", "nginx.conf"):
        text = (ROOT / "docker/cluster" / name).read_text()
        assert set(re.findall(r"node-\d", text)) == set(NAMES)
