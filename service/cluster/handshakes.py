"""Handshakes of streams among several nodes: whose ticket it is, and which node has the session."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import Scope

from ..auth import Authenticator, IssuedTicket, shown_tickets
from ..keys import Identity
from .asking import StoreAway
from .node import ClusterNode

# A ticket of another node is spent by the handshake that has shown it, within this time.
LEARNED_S = 10.0


class Handshakes:
    """Prepares the handshakes of a node, so that they can be admitted like those of a service that is one process."""

    def __init__(self, node: ClusterNode, authenticator: Authenticator) -> None:
        self._node, self._authenticator = node, authenticator

    async def prepare(self, scope: Scope, headers: Headers) -> None:
        """Make sure that the session is here and its ticket known. Raises elsewhere, unauthenticated and others."""
        sid = scope["path_params"].get("session_id")
        if sid is None:
            return
        self._authenticator.check_browser(headers)
        tickets = shown_tickets(scope["subprotocols"])
        identity = await self._bearer(tickets[0], sid) if tickets else self._authenticator.identify(headers)
        if identity is None:
            return  # will be refused
        query = scope["query_string"].decode("latin-1")
        await self._node.locate(identity.owner, sid, f"/stream{'?' if query else ''}{query}", websocket=True)
        for ticket in tickets:
            await self._spend(ticket)

    async def _bearer(self, ticket: str, sid: str) -> Identity | None:
        """Return whose ticket it is, if it is of this session."""
        known = self._authenticator.peek(ticket)
        if known is None:
            try:
                found = await self._node.tickets.find(ticket, spend=False)
            except StoreAway:
                return None
            known = found and IssuedTicket(*found)
        return known.identity if known and known.session == sid else None

    async def _spend(self, ticket: str) -> None:
        """Take a ticket from the store: this node alone admits whoever shows it."""
        try:
            found = await self._node.tickets.find(ticket, spend=True)
        except StoreAway:
            return  # a ticket of this node stays valid here
        if found is None:
            self._authenticator.void(ticket)
        else:
            self._authenticator.learn(ticket, IssuedTicket(*found), LEARNED_S)
