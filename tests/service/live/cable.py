"""A cable between client and server that can be cut, or go dead without a sign."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Self


class Cable:
    """Forwards TCP connections on a port of its own to ``port``."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._server: asyncio.Server | None = None
        self._open: list[asyncio.StreamWriter] = []
        self._flows = asyncio.Event()
        self._flows.set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._dead: set[asyncio.Task[None]] = set()
        self.connections = 0
        self.mute = False
        """New connections carry nothing of what the server says."""

    @property
    def url(self) -> str:
        assert self._server is not None
        return f"http://127.0.0.1:{self._server.sockets[0].getsockname()[1]}"

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._connected, "127.0.0.1", 0)
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        self.cut()
        for task in self._tasks:
            task.cancel()

    def lead_to(self, port: int) -> None:
        """Reset all connections; new ones go to another port, as a Kubernetes Service chooses another pod."""
        self._port = port
        self.cut()

    def cut(self) -> None:
        """Reset all connections."""
        for writer in self._open:
            if not writer.transport.is_closing():
                writer.transport.abort()
        self._open.clear()

    def go_dead(self) -> None:
        """Connections that are open carry nothing any more, and nobody is told; new ones work."""
        self._open.clear()
        self._dead |= self._tasks

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        try:
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._port)
        except OSError:
            writer.transport.abort()
            return
        self._open += [writer, far_writer]
        ways = ((reader, far_writer), (far_reader, writer))
        for source, sink in ways[:1] if self.mute else ways:
            task = asyncio.create_task(self._carry(source, sink))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _carry(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while data := await source.read(65536):
                if asyncio.current_task() in self._dead:
                    continue
                sink.write(data)
                await sink.drain()
        if asyncio.current_task() not in self._dead:
            sink.close()
