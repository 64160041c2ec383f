"""Small proxies that lead every name to this machine: HTTP with CONNECT, and SOCKS 5."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Self
from urllib.parse import urlsplit


class Proxy:
    """A proxy on a free loopback port; ``asked`` are the hosts and ports that its clients wanted."""

    scheme = "http"

    def __init__(self) -> None:
        self.asked: list[str] = []
        self._server: asyncio.Server | None = None

    @property
    def url(self) -> str:
        assert self._server is not None
        return f"{self.scheme}://127.0.0.1:{self._server.sockets[0].getsockname()[1]}"

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError, asyncio.IncompleteReadError):
            host, port, hello, first = await self._wanted(reader, writer)
            self.asked.append(f"{host}:{port}")
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(hello)
            far_writer.write(first)
            await asyncio.gather(_carry(reader, far_writer), _carry(far_reader, writer))

    async def _wanted(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> tuple[str, int, bytes, bytes]:
        """The host and port, what the client is told when they are reached, and what they are told first."""
        head = await reader.readuntil(b"\r\n\r\n")
        method, target, *_ = head.decode("latin-1").split(" ", 2)
        if method == "CONNECT":
            host, _, port = target.rpartition(":")
            return host, int(port), b"HTTP/1.1 200 OK\r\n\r\n", b""
        parts = urlsplit(target)
        head = head.replace(target.encode(), target.removeprefix(f"http://{parts.netloc}").encode(), 1)
        head = head.replace(b"\r\n\r\n", b"\r\nConnection: close\r\n\r\n")
        return parts.hostname or "", parts.port or 80, b"", head


class SocksProxy(Proxy):
    """SOCKS 5 without authentication, with names that the proxy looks up."""

    scheme = "socks5h"

    async def _wanted(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> tuple[str, int, bytes, bytes]:
        _, count = await reader.readexactly(2)
        await reader.readexactly(count)
        writer.write(b"\x05\x00")
        _, _, _, kind, length = await reader.readexactly(5)
        assert kind == 3  # a name
        name = (await reader.readexactly(length)).decode()
        port = int.from_bytes(await reader.readexactly(2))
        return name, port, b"\x05\x00\x00\x01\x00\x00\x00\x00\x00\x00", b""


async def _carry(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while data := await source.read(65536):
            sink.write(data)
            await sink.drain()
    sink.close()
