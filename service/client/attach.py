"""Attaching to a session, at first and again after a break."""

from __future__ import annotations

import asyncio
import random
import time
from dataclasses import dataclass

from .connection import Address, Connection, Protocol
from .errors import ClientError, ConnectionLost, Problem
from .types import Mode, Ready

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

    async def reopen(self, before: Ready, pause_s: float) -> tuple[Connection, Ready]:
        """Attach again after ``pause_s``, with back-off; takes over nothing but what ``before`` began.

        Raises what ended the last attempt, when it cannot pass or the time is over.
        """
        give_up = time.monotonic() + self.reconnect_for_s
        delay, wait = FIRST_DELAY_S, pause_s
        while True:
            await asyncio.sleep(wait)
            try:
                return await self._open(False, None, before.attachment)
            except ClientError as failed:
                if time.monotonic() > give_up or not _may_pass(failed, before):
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


def _may_pass(failed: ClientError, before: Ready) -> bool:
    if not isinstance(failed, Problem):
        return True
    if failed.code == "attached-elsewhere":  # by somebody else, where our own attachment has a name
        return before.attachment is None
    return failed.status >= 500 or failed.code == "rate-limited"
