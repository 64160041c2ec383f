"""A service goes away and comes back; meanwhile whatever stands in for it answers its clients."""

from __future__ import annotations

import asyncio
from pathlib import Path

from service.load.own import OwnServer, free_port

from .cable import Cable
from .conftest import Serve

PROXY_ANSWER = b"HTTP/1.1 %d Away\r\ncontent-type: text/html\r\ncontent-length: 2\r\nconnection: close\r\n\r\n:("


class Rollout:
    """Two services with sessions of their own behind one address, the first of which is to be replaced.

    ``cable`` is the address: like a Kubernetes Service it leads to who is ready.
    """

    def __init__(self, own_server: Serve, folder: Path) -> None:
        self.first: OwnServer = own_server(state_dir=folder / "first")
        self.second: OwnServer = own_server(state_dir=folder / "second")
        self.cable = Cable(self.first.port)

    async def happen(self) -> None:
        """The first service restarts; its clients meet the second one, two errors of a proxy, and nobody."""
        await asyncio.to_thread(self.first.stop)
        self.cable.lead_to(self.second.port)
        while "session-not-found" not in self.second.log:
            await asyncio.sleep(0.02)
        for status in (502, 503, 404):
            await self._proxy_says(status)
        refused = self.cable.connections
        self.cable.lead_to(free_port())
        while self.cable.connections == refused:
            await asyncio.sleep(0.02)
        await asyncio.to_thread(self.first.start)
        self.cable.lead_to(self.first.port)

    async def _proxy_says(self, status: int) -> None:
        """Lead to a proxy that has nobody to ask, until a client was told so."""
        refused = asyncio.Event()

        async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.readuntil(b"\r\n\r\n")
            writer.write(PROXY_ANSWER % status)
            await writer.drain()
            writer.close()
            refused.set()

        proxy = await asyncio.start_server(answer, "127.0.0.1", 0)
        self.cable.lead_to(proxy.sockets[0].getsockname()[1])
        await refused.wait()
        proxy.close()
