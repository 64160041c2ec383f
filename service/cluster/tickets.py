"""Tickets that every node knows and one handshake spends."""

from __future__ import annotations

from typing import Any

import msgpack
import redis
import structlog

from ..keys import Identity
from .asking import Asking, StoreAway
from .redis_store import key

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.cluster")


class SharedTickets:
    """The tickets of all nodes, by their digests."""

    def __init__(self, client: redis.Redis, ask: Asking) -> None:
        self._client, self._ask = client, ask

    async def share(self, name: str, identity: Identity, sid: str, ttl_s: float) -> None:
        """Have every node know a ticket, of which ``name`` is the digest."""
        ticket = msgpack.packb((identity.owner, identity.key, sid))
        try:
            await self._ask(self._client.set, key("ticket", name), ticket, px=int(ttl_s * 1e3))
        except StoreAway:
            log.warning("a ticket is known to this node alone")

    async def find(self, name: str, *, spend: bool) -> tuple[Identity, str] | None:
        """Return whose ticket it is and of which session; with ``spend`` nobody else gets it after that.

        Raises StoreAway.
        """
        found: Any = await self._ask(self._client.getdel if spend else self._client.get, key("ticket", name))
        if found is None:
            return None
        owner, digest, sid = msgpack.unpackb(found)
        return Identity(owner, digest), sid
