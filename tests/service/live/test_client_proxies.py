"""The Python client where the environment names a proxy."""

from __future__ import annotations

import asyncio
import os
import sys
import threading

import httpcore2  # noqa: F401 -- it looks for socksio as it is imported; later some tests hide that
import pytest

from service.client import AsyncClient, Client, ConnectionLost, Problem
from service.client.connect import Connector
from service.load.clips import Clip
from service.load.own import OwnServer, free_port

from .conftest import Serve
from .proxies import Proxy, SocksProxy

KEY = "a-key-of-somebody-behind-a-proxy"


@pytest.fixture(autouse=True)
def no_other_proxies(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list(os.environ):
        if name.lower().endswith("_proxy"):
            monkeypatch.delenv(name)


@pytest.mark.parametrize("variable", ["ALL_PROXY", "HTTP_PROXY", "http_proxy"])
@pytest.mark.parametrize("scheme", ["http", "socks5"])
def test_this_machine_is_reached_without_a_proxy(
    server: OwnServer, clip: Clip, monkeypatch: pytest.MonkeyPatch, variable: str, scheme: str
) -> None:
    monkeypatch.setenv(variable, f"{scheme}://127.0.0.1:{free_port()}")
    monkeypatch.setitem(sys.modules, "socksio", None)
    for host in ("127.0.0.1", "localhost"):
        with Client(f"http://{host}:{server.port}") as client, client.create(clip.frames[0], clip.box) as session:
            assert len(list(session.stream(clip.frames[1:4], mode="lossless"))) == 3


@pytest.mark.parametrize(("variable", "kind"), [("HTTP_PROXY", Proxy), ("ALL_PROXY", Proxy), ("ALL_PROXY", SocksProxy)])
async def test_calls_and_streams_go_through_the_proxy(
    own_server: Serve, clip: Clip, monkeypatch: pytest.MonkeyPatch, variable: str, kind: type[Proxy]
) -> None:
    server = own_server(api_keys=KEY)
    async with kind() as proxy:
        monkeypatch.setenv(variable, proxy.url)
        async with AsyncClient(f"http://tracking.test:{server.port}", key=KEY) as client:
            session = await client.create(clip.frames[0], clip.box)
            calls = len(proxy.asked)
            results = [r async for r in session.stream(clip.frames[1:4], mode="lossless")]
            await session.close()
    assert len(results) == 3
    assert len(proxy.asked) > calls > 0
    assert set(proxy.asked) == {f"tracking.test:{server.port}"}


@pytest.mark.parametrize(
    ("host", "no_proxy"),
    [
        ("tracking.test", "tracking.test"),
        ("tracking.test", "example.org, .test"),
        ("tracking.test", "*"),
        ("192.0.2.7", "192.0.2.0/24"),
        ("[2001:db8::7]", "2001:db8::/32"),
        ("[2001:db8::7]", "2001:db8::7"),
    ],
)
def test_what_no_proxy_names_is_reached_without_one(monkeypatch: pytest.MonkeyPatch, host: str, no_proxy: str) -> None:
    monkeypatch.setenv("ALL_PROXY", "http://127.0.0.1:9")
    for url in (f"http://{host}", f"https://{host}:8443"):
        assert AsyncClient(url).address.proxy is not None
    monkeypatch.setenv("NO_PROXY", no_proxy)
    for url in (f"http://{host}", f"https://{host}:8443"):
        assert AsyncClient(url).address.proxy is None


def test_socks_without_its_package_is_told_and_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ALL_PROXY", "socks5://me:secret@127.0.0.1:1080")
    monkeypatch.setitem(sys.modules, "socksio", None)
    before = threading.enumerate()
    with pytest.raises(
        ConnectionLost, match=r"proxy socks5://127\.0\.0\.1:1080 \(ALL_PROXY\) .*pip install socksio"
    ) as lost:
        Client("http://tracking.test")
    assert "secret" not in str(lost.value)
    assert threading.enumerate() == before


async def test_a_proxy_that_cannot_be_used_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", "http://me:secret@127.0.0.1:9")
    named = r"http://tracking\.test through the proxy http://127\.0\.0\.1:9 \(http_proxy\)"
    async with AsyncClient("http://tracking.test", timeout_s=5) as client:
        for call in (client.capabilities(), Connector(client.places, "id").open()):
            with pytest.raises(ConnectionLost, match=named) as lost:
                await call
            assert "secret" not in str(lost.value)
    monkeypatch.setenv("http_proxy", "gopher://127.0.0.1")
    with pytest.raises(ConnectionLost, match=r"gopher://127\.0\.0\.1 \(http_proxy\) cannot be used"):
        AsyncClient("http://tracking.test")


async def test_an_error_of_the_proxy_itself_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"HTTP/1.1 502 Bad Gateway\r\ncontent-length: 6\r\nconnection: close\r\n\r\n<html>")
        await writer.drain()
        writer.close()

    proxy = await asyncio.start_server(answer, "127.0.0.1", 0)
    monkeypatch.setenv("HTTP_PROXY", f"127.0.0.1:{proxy.sockets[0].getsockname()[1]}")
    async with proxy, AsyncClient("http://tracking.test", timeout_s=5) as client:
        with pytest.raises(Problem, match=r"HTTP 502 through the proxy http://127\.0\.0\.1:\d+ \(HTTP_PROXY\)"):
            await client.capabilities()
        with pytest.raises(ConnectionLost, match=r"through the proxy .* \(HTTP_PROXY\).*502"):
            await Connector(client.places, "id").open()
