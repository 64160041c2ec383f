"""uvicorn, set up for frames and with a drain before it ends."""

from __future__ import annotations

import asyncio
import gc
import os
import random
import signal
from collections.abc import Callable
from importlib.util import find_spec
from types import FrameType
from typing import Any

import anyio
import structlog
import uvicorn
from fastapi import FastAPI

from .connections import allow_files, protocols
from .service import Service
from .settings import Settings

# ByteBudget for the envelope of a MessagePack message.
ENVELOPE_BYTES = 4096
SHUTDOWN_S = 5
# All waiting connections are accepted in one turn of the event loop; more than these try again a second later.
BACKLOG = 256
DRAIN_TICK_S = READY_TICK_S = 0.05
# Clients may come back after this time, and a random part of the spread later.
RETURN_S = 0.5
SPREAD_S = (0.0, 1.5)
NODE_SPREAD_S = (0.0, 0.3)

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.server")


class Server(uvicorn.Server):
    """A server that drains at the first signal and stops at once at the second."""

    def __init__(self, config: uvicorn.Config, service: Service, on_ready: Callable[[str], None]) -> None:
        super().__init__(config)
        self._service = service
        self._on_ready = on_ready
        self._telling: asyncio.Task[None] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._draining: asyncio.Task[None] | None = None

    async def serve(self, sockets: Any = None) -> None:
        """Serve until a signal, which may come at any time from now on."""
        self._loop = asyncio.get_running_loop()
        await super().serve(sockets)

    async def startup(self, sockets: Any = None) -> None:
        """Start, and log the address."""
        if not allow_files(self._service.settings):
            log.warning("the limit of open files (ulimit -n) is below MFCMT_MAX_CONNECTIONS: raise it or lower that")
        async with anyio.create_task_group():
            pass  # loads what the first answer in parts would load, for 40 ms, beside streams
        await super().startup(sockets)
        # The objects that exist now stay: looking for garbage among them would hold up the loop for tens of ms.
        gc.collect()
        gc.freeze()
        if self.started:
            host, port = self.servers[0].sockets[0].getsockname()[:2]
            settings = self._service.settings
            scheme = "https" if settings.tls_certificate else "http"
            url = f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}"
            log.info("listening", url=url, lanes=settings.lanes, capacity=settings.capacity)
            self._telling = asyncio.create_task(self._tell_ready(url))

    async def _tell_ready(self, url: str) -> None:
        """Report the address once a lane is ready, so that sessions can be created."""
        while not any(lane.ready for lane in self._service.lanes.status()):
            await asyncio.sleep(READY_TICK_S)
        log.info("ready", url=url)
        self._on_ready(url)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:  # noqa: ARG002
        """Drain or stop. Runs as a signal handler on the main thread."""
        assert self._loop is not None
        self._loop.call_soon_threadsafe(self._leave, signal.Signals(sig).name)

    def _leave(self, name: str) -> None:
        if self._draining is None:
            self._draining = asyncio.ensure_future(self._drain(name))
        else:
            log.info("stopping at once", signal=name)
            self._service.registry.end_streams(1012, "service restart")
            # No cleanup is needed: the lanes end with this process, and the saved state is complete.
            asyncio.get_running_loop().call_later(DRAIN_TICK_S, os._exit, 0)

    async def _drain(self, name: str) -> None:
        registry, grace_s = self._service.registry, self._service.settings.drain_grace_s
        log.info("draining", signal=name, streams=registry.streams(), sessions=len(registry))
        # Without a state directory streams may go on for the grace period; with one they may come back at once.
        # The returns are spread, so that not all clients meet the next process at the same moment.
        # Another node is there already.
        node = self._service.node
        soonest_s = 0.0 if node else RETURN_S if registry.store.durable else grace_s
        spread_s = NODE_SPREAD_S if node else SPREAD_S
        registry.drain(lambda: round(soonest_s + random.uniform(*spread_s), 2))  # noqa: S311
        deadline = asyncio.get_running_loop().time() + grace_s
        while (registry.streams() or (node and node.leaving)) and asyncio.get_running_loop().time() < deadline:
            await asyncio.sleep(DRAIN_TICK_S)
        registry.end_streams(1012, "service restart")
        await asyncio.sleep(DRAIN_TICK_S)
        self.should_exit = True


def make_server(app: FastAPI, on_ready: Callable[[str], None] = lambda _: None) -> Server:
    """Return a server for the application of ``create_app``; call its ``run()`` or ``serve()``.

    ``on_ready`` is called with the service's URL when the first lane is ready.
    """
    service: Service = app.state.service
    settings: Settings = service.settings
    calls, frames = protocols(settings, service.byte_budget)
    config = uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        ssl_certfile=settings.tls_certificate,
        ssl_keyfile=settings.tls_key,
        loop="uvloop" if find_spec("uvloop") else "asyncio",
        http=calls,
        ws=frames,
        backlog=BACKLOG,
        ws_max_size=2 * settings.max_frame_bytes + ENVELOPE_BYTES,
        ws_per_message_deflate=False,
        ws_ping_interval=settings.ping_interval_s,
        ws_ping_timeout=settings.ping_timeout_s,
        timeout_graceful_shutdown=SHUTDOWN_S,
        server_header=False,
        access_log=False,
        log_config=None,
        lifespan="on",
    )
    return Server(config, service, on_ready)
