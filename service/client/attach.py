"""Attaching to a session, at first and again after a break."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from .address import Address
from .connection import Connection, Protocol
from .errors import ClientError, ConnectionLost, Problem
from .types import Draining, Mode, Ready

FIRST_DELAY_S, LONGEST_DELAY_S = 0.05, 5.0


@dataclass(frozen=True, slots=True)
class Attachment:
    """Which session is attached to, how, and for how long a broken connection is tried again."""

    address: Address
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
        self, before: Ready, told: Draining, take_up: Callable[[Connection, Ready], Awaitable[None]]
    ) -> Connection:
        """Attach again and ``take_up`` where the stream was, with back-off, after the pause that was ``told``.

        Takes over nothing but what ``before`` and the attempts began. Raises what ended the last attempt, when it
        cannot pass or the time is over.
        """
        give_up = time.monotonic() + told.reconnect_in_s + self.reconnect_for_s
        delay, wait, unheard = FIRST_DELAY_S, told.reconnect_in_s, False
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
                # An attempt that was not heard may have attached under a name that we do not know.
                unheard |= isinstance(failed, ConnectionLost)
                ours = before.attachment is None or unheard
                if time.monotonic() > give_up or not _may_pass(failed, ours, told.resumable):
                    raise
                wait = delay * random.uniform(0.5, 1.0)  # noqa: S311
                if isinstance(failed, Problem) and failed.retry_after_s is not None:
                    wait = max(wait, failed.retry_after_s)
                delay = min(2 * delay, LONGEST_DELAY_S)

    async def _open(self, takeover: bool, ticket: str | None, resume: str | None) -> tuple[Connection, Ready]:
        connection = await Connection.open(
            self.address,
            self.session_id,
            mode=self.mode,
            protocol=self.protocol,
            ticket=ticket,
            takeover=takeover,
            resume=resume,
        )
        try:
            ready = await asyncio.wait_for(connection.receive(), self.address.timeout_s)
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
    replica does not know the session, a proxy knows nobody. ``ours``: what is attached may be left behind by us.
    """
    if not isinstance(failed, Problem):
        return True
    if failed.code == "attached-elsewhere":
        return ours
    if failed.status == 404:
        return resumable
    return failed.status >= 500 or failed.code == "rate-limited"
