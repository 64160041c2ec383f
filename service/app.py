"""The application, built from its settings."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from importlib.metadata import version
from secrets import token_bytes
from typing import TYPE_CHECKING, Any

import structlog
from fastapi import FastAPI
from starlette.datastructures import Headers
from starlette.routing import WebSocketRoute
from starlette.types import Scope

from .api import (
    capabilities,
    docs,
    errors,
    frames,
    health,
    openapi,
    sessions,
    snapshot,
    targets,
    ticket,
    trajectory,
    web,
)
from .api.middleware import RequestMiddleware
from .api.stream import StreamEndpoint
from .auth import Authenticator
from .bridges import BRIDGES
from .lanes.interface import Lanes
from .lanes.limits import LaneLimits
from .lanes.pool import LanePool
from .observability.exporter import PrometheusExporter
from .observability.metrics import Metrics
from .service import Service
from .sessions.byte_budget import ByteBudget
from .sessions.concurrency import ConcurrencyLimit
from .sessions.database import StateError
from .sessions.rate_limiter import RateLimiter
from .sessions.registry import SessionRegistry
from .settings import Settings
from .snapshot_signer import SnapshotSigner

if TYPE_CHECKING:
    from .cluster.node import ClusterNode
    from .observability.tracing import Tracing

SECRET_BYTES = 32
# Pause after a fault in the background, so that one that lasts does not fill the log.
AGAIN_S = 1.0
# Snapshots and trajectories of one key that are made at once; others wait for their turn.
SNAPSHOTS_AT_ONCE = TRAJECTORIES_AT_ONCE = 2

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.app")


def create_app(
    settings: Settings | None = None,
    *,
    lanes: Lanes | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> FastAPI:
    """Return the service as an ASGI application; ``app.state.service`` holds its parts.

    Parameters
    ----------
    settings
        The settings; by default those of the environment.
    lanes
        Takes the place of the worker processes, in tests.
    clock
        The monotonic clock of expiry in seconds, which tests replace.
    """
    service = _service(settings or Settings(), lanes, clock)
    app = FastAPI(
        title="MFCMT",
        lifespan=_lifespan,
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        generate_unique_id_function=lambda route: route.name,
    )
    app.state.service = service
    calls = (sessions, frames, targets, trajectory, snapshot, ticket, capabilities)
    routers = {"/v1": [module.router for module in calls], "": [health.router, docs.router, web.router]}
    for prefix, some in routers.items():
        for router in some:
            app.include_router(router, prefix=prefix)
    for name in service.settings.bridges:
        app.include_router(BRIDGES[name].load(service), include_in_schema=False)
    stream = StreamEndpoint(service, _join(app, service))
    for path in ("/v1/sessions/{session_id}/stream", "/{path:path}"):  # the second refuses
        app.router.routes.append(WebSocketRoute(path, stream))
    app.add_middleware(RequestMiddleware, service=service)
    errors.install(app)
    openapi.install(app, service.settings)
    app.state.documents = docs.Documents.of(app)
    app.state.assets = web.load()
    return app


def _service(settings: Settings, lanes: Lanes | None, clock: Callable[[], float]) -> Service:
    """Return the parts of the service."""
    metrics = Metrics(_tracing(settings))
    lanes = lanes or local_lanes(settings)
    authenticator = Authenticator(settings, clock)
    node = _node(settings, lanes, metrics)
    registry = SessionRegistry(settings, lanes, metrics, clock, authenticator.owners, node)
    secrets = [secret.get_secret_value().encode() for secret in settings.signing_keys]
    signer = SnapshotSigner(secrets or [token_bytes(SECRET_BYTES)])
    rate_limiter, byte_budget = RateLimiter(settings, clock), ByteBudget(settings.max_upload_bytes)
    metrics.watch_byte_budget(byte_budget)
    return Service(
        settings,
        lanes,
        registry,
        authenticator,
        metrics,
        PrometheusExporter(metrics, registry.__len__, settings.capacity, lanes, registry.store.budget),
        rate_limiter,
        byte_budget,
        signer,
        *slots(settings),
        node,
    )


def slots(settings: Settings) -> tuple[ConcurrencyLimit, ConcurrencyLimit]:
    """Return the limits of snapshots and of trajectories of a key that are made at once."""
    wait_s = settings.operation_deadline_s
    snapshots = ConcurrencyLimit(SNAPSHOTS_AT_ONCE, wait_s, "snapshots")
    return snapshots, ConcurrencyLimit(TRAJECTORIES_AT_ONCE, wait_s, "trajectories")


def local_lanes(settings: Settings) -> LanePool:
    """Return worker processes on this machine. They inherit the environment, so the settings are taken out of it."""
    settings.leave_environment()
    return LanePool(
        settings.lanes,
        settings.max_sessions_per_lane,
        LaneLimits.of(settings),
        deadline_s=settings.operation_deadline_s,
        start_timeout_s=settings.lane_start_timeout_s,
        max_rss_bytes=settings.max_lane_rss_bytes,
    )


def _node(settings: Settings, lanes: Lanes, metrics: Metrics) -> ClusterNode | None:
    """Return this node among others, None where it is the only one. Raises StateError."""
    if settings.store is None:
        return None
    try:
        from .cluster.make import make_node
    except ModuleNotFoundError as missing:
        raise StateError(f"MFCMT_STORE needs the package {missing.name}: pip install 'mfcmt[cluster]'") from missing
    return make_node(settings, lanes, metrics)


def _join(app: FastAPI, service: Service) -> Callable[[Scope, Headers], Awaitable[None]] | None:
    """Have this node find the sessions of others; return what a handshake needs for it, None for the only node."""
    if service.node is None:
        return None
    from .cluster.make import join

    return join(app, service, service.node)


def _tracing(settings: Settings) -> Tracing | None:
    if not settings.otlp_endpoint:
        return None
    from .observability.tracing import Tracing

    return Tracing(settings.otlp_endpoint, settings.trace_ratio, version("mfcmt"))


async def _run_forever(work: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Do ``work``, which does not end by itself, and start it again whenever it fails."""
    while True:
        try:
            await work()
        except Exception:
            log.exception("background task failed and is started again")
        await asyncio.sleep(AGAIN_S)


@contextlib.asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    service: Service = app.state.service
    settings = service.settings
    if not settings.signing_keys:
        log.warning("no MFCMT_SIGNING_KEYS: snapshots are valid until this process ends")
    if not settings.authenticated and not settings.on_loopback:
        log.warning("listening beyond loopback without keys: everyone shares all sessions", host=settings.host)
    if not settings.state_dir and not service.node:
        log.warning("no MFCMT_STATE_DIR: sessions end with this process")
    tasks: list[asyncio.Task[None]] = []
    try:
        await service.registry.load()
        await service.lanes.start()
        if service.node is not None:
            await service.node.start()
        registry = service.registry
        background = [registry.run_sweeper, registry.follow_lanes, service.follow_keys, service.metrics.lag.watch]
        if service.node is not None:
            background.append(service.node.run)
        tasks += [asyncio.create_task(_run_forever(work)) for work in background]
        yield
    finally:
        if service.node is not None:
            await service.node.stop()
        await service.registry.save_all()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await service.lanes.stop()
        if service.metrics.tracing is not None:
            await asyncio.to_thread(service.metrics.tracing.stop)
