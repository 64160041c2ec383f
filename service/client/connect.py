"""Attaches to a session: at first, and again after a break."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from ..protocol.enums import ProblemCode
from .connection import Connection, Protocol
from .errors import ClientError, ConnectionLost, Problem
from .places import Places
from .types import Draining, Mode, Ready

FIRST_DELAY_S, LONGEST_DELAY_S = 0.05, 2.0
# How long a service of several nodes is asked again for a session whose node does not answer: longer than the lease of
# a node that is gone.
NODE_GONE_S, ASK_AGAIN_S = 10.0, 0.5


@dataclass(frozen=True, slots=True)
class Connector:
    """Attaches to one session, and again after a break for ``reconnect_for_s`` seconds at most."""

    places: Places
    session_id: str
    mode: Mode = "latest"
    protocol: Protocol = "mfcmt.v1.msgpack"
    takeover: bool = False
    ticket: str | None = None
    reconnect_for_s: float = 60.0

    async def open(self) -> tuple[Connection, Ready]:
        """Attach for the first time. Raises :class:`Problem` and :class:`ConnectionLost`."""
        return await self._open(self.takeover, self.ticket, None)

    async def reopen(
        self, before: Ready, draining: Draining, take_up: Callable[[Connection, Ready], Awaitable[None]]
    ) -> Connection:
        """Attach again, with back-off, after the pause that the service asked for.

        Parameters
        ----------
        before
            What the service said on attaching; only that attachment, and those of the attempts, are taken over.
        draining
            What the service said before the connection broke, if it did.
        take_up
            Makes the stream go on with the new connection; an attempt in which it fails has failed.

        Raises
        ------
        ClientError
            What ended the last attempt, when trying again does not help or the time is over.
        """
        give_up = time.monotonic() + draining.reconnect_in_s + self.reconnect_for_s
        delay, wait, unheard = FIRST_DELAY_S, draining.reconnect_in_s, False
        if draining.url is not None:
            self.places.learn(draining.url)
        while True:
            await asyncio.sleep(wait)
            try:
                connection, before = await self._open(False, None, before.attachment)
                try:
                    await take_up(connection, before)
                except BaseException:
                    await connection.close()
                    raise
                return connection
            except ClientError as failed:
                # An attempt without an answer may have attached under a name that we do not know.
                unheard |= isinstance(failed, ConnectionLost)
                if time.monotonic() > give_up or not _may_pass(failed, unheard, draining.resumable):
                    raise
                wait = delay * random.uniform(0.5, 1.0)  # noqa: S311
                if isinstance(failed, Problem) and failed.retry_after_s is not None:
                    wait = max(wait, failed.retry_after_s)
                delay = min(2 * delay, LONGEST_DELAY_S)

    async def _open(self, takeover: bool, ticket: str | None, resume: str | None) -> tuple[Connection, Ready]:
        """Attach at the node that has the session."""
        give_up = time.monotonic() + NODE_GONE_S
        while True:
            try:
                return await self._attach(takeover, ticket, resume)
            except Problem as refused:
                if refused.code != ProblemCode.ELSEWHERE or refused.url is None or time.monotonic() > give_up:
                    raise
                self.places.learn(refused.url)
            except ConnectionLost:
                if not self.places.forget(self.session_id) or time.monotonic() > give_up:
                    raise
                await asyncio.sleep(ASK_AGAIN_S)

    async def _attach(self, takeover: bool, ticket: str | None, resume: str | None) -> tuple[Connection, Ready]:
        address = self.places.address(self.session_id)
        connection = await Connection.open(
            address,
            self.session_id,
            mode=self.mode,
            protocol=self.protocol,
            ticket=ticket,
            takeover=takeover,
            resume=resume,
        )
        try:
            ready = await asyncio.wait_for(connection.receive(), address.timeout_s)
        except TimeoutError as late:
            await connection.close()
            raise ConnectionLost("the server does not answer") from late
        if isinstance(ready, Ready):
            return connection, ready
        await connection.close()
        raise ready if isinstance(ready, Problem) else ConnectionLost("the stream began without ready")


def _may_pass(failed: ClientError, ours: bool, resumable: bool) -> bool:
    """Whether another attempt may succeed.

    While the process that has the session is away, whatever stands in for it says 404, 502 or 503: another
    replica does not know the session, and a proxy reaches nobody. ``ours``: the attachment in the way may be ours.
    """
    if not isinstance(failed, Problem):
        return True
    if failed.code == ProblemCode.ATTACHED_ELSEWHERE:
        return ours
    if failed.status == 404:
        return resumable
    return failed.status >= 500 or failed.code == ProblemCode.RATE_LIMITED
