"""The nodes that live: each renews a lease in Redis, and learns from it who the others are."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import msgpack

from . import scripts
from .redis_store import Node, RedisStore, key, now_ms

# A node whose lease has run out is gone: its sessions go on where their clients ask for them.
LEASE_S = 6.0
BEAT_EVERY_S = 2.0


class NodeReplaced(Exception):
    """Another process has started under the name of this node."""


@dataclass(frozen=True, slots=True)
class Load:
    """What a node says of itself: its free places, whether it takes sessions, and the streams of each owner."""

    free: int = 0
    open: bool = True
    streams: Mapping[str, int] = field(default_factory=dict)


class Membership:
    """The lease of this node, and what the others said of themselves when it was last renewed."""

    def __init__(self, store: RedisStore) -> None:
        self.peers: dict[Node, Load] = {}
        self._store, self._client, self._node = store, store.client, store.node
        self._script = self._client.register_script(scripts.BEAT)
        self._beat = 0
        self._renewed = float("-inf")

    @property
    def holds(self) -> bool:
        """Whether the lease is certainly ours: no other node takes our sessions for those of a dead one."""
        return time.monotonic() < self._renewed + LEASE_S

    @property
    def silent_s(self) -> float:
        """The seconds since Redis has answered last."""
        return time.monotonic() - self._renewed

    def renew(self, load: Load) -> bool:
        """Renew the lease and read those of the others; return whether Redis may have lost what it knew of us.

        That is so at the first beat, after the lease has run out, and when Redis has another beat than our last one.
        Raises NodeReplaced, and what redis raises.
        """
        asked, node = time.monotonic(), self._node
        fields = {"url": node.url, "load": msgpack.packb([load.free, load.open, dict(load.streams)])}
        flat = [part for pair in fields.items() for part in pair]
        words = [node.name, node.incarnation, self._beat, int(LEASE_S * 1e3), now_ms(), *flat]
        incarnation, beat = self._script(keys=[key("node", node.name), key("nodes", "all")], args=words)
        if self._beat and incarnation is not None and incarnation.decode() != node.incarnation:
            raise NodeReplaced(f"another process has started as the node {node.name}: give each its own MFCMT_NODE")
        lost = beat is None or incarnation is None or int(beat) != self._beat - 1
        self._beat += 1
        self._renewed = asked
        self.peers = self._read_peers()
        return lost

    def leave(self) -> None:
        """Give up the lease."""
        self._client.delete(key("node", self._node.name))

    def _read_peers(self) -> dict[Node, Load]:
        names: Any = self._client.zrangebyscore(key("nodes", "all"), now_ms() - 60_000, "+inf")
        others = [name.decode() for name in names if name.decode() != self._node.name]
        pipe = self._client.pipeline(transaction=False)
        for name in others:
            pipe.hmget(key("node", name), "incarnation", "url", "load")
        peers = {}
        for name, (incarnation, url, load) in zip(others, pipe.execute(), strict=True):
            if incarnation is not None:
                free, is_open, streams = msgpack.unpackb(load)
                peers[Node(name, incarnation.decode(), url.decode())] = Load(free, is_open, streams)
        return peers
