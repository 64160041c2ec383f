"""Makes this node from its settings."""

from __future__ import annotations

import os

from ..lanes.interface import Lanes
from ..observability.metrics import Metrics
from ..sessions.database import StateError
from ..settings import Settings
from .node import ClusterNode
from .redis_store import Node, RedisStore


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
