"""Makes this node from its settings, and has the application find the sessions of the others."""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable

from fastapi import FastAPI
from starlette.datastructures import Headers
from starlette.types import Scope

from ..lanes.interface import Lanes
from ..observability.metrics import Metrics
from ..service import Service
from ..sessions.database import StateError
from ..settings import Settings
from .handshakes import Handshakes
from .node import ClusterNode
from .redis_store import Node, RedisStore
from .router import SessionRouter


def make_node(settings: Settings, lanes: Lanes, metrics: Metrics) -> ClusterNode | None:
    """Return this node, None where it is the only one. Raises StateError for a store that cannot be named."""
    if settings.store is None:
        return None
    me = Node(settings.node, os.urandom(8).hex(), settings.node_url)
    try:
        database = RedisStore(
            settings.store.get_secret_value(),
            me,
            metrics,
            every_s=settings.store_every_s,
            remember_s=settings.tombstone_s,
        )
    except ValueError as wrong:
        raise StateError(f"MFCMT_STORE cannot be used: {wrong}") from wrong
    return ClusterNode(settings, database, lanes)


def join(app: FastAPI, service: Service, node: ClusterNode) -> Callable[[Scope, Headers], Awaitable[None]]:
    """Have calls find the sessions of all nodes; return what makes sure of it before a handshake."""
    node.registry = service.registry
    app.add_middleware(SessionRouter, node=node, settings=service.settings)
    return Handshakes(node, service.authenticator).prepare
