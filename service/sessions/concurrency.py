"""A limit on how many large pieces of work each key may have in progress at once."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass

from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError


@dataclass(slots=True)
class _Slots:
    """The slots of one owner, and how many callers use them or wait for one."""

    free: asyncio.Semaphore
    users: int = 0


class ConcurrencyLimit:
    """Lets each owner do ``limit`` pieces of work at once; a caller that waits longer than ``wait_s`` is refused."""

    def __init__(self, limit: int, wait_s: float, what: str) -> None:
        self._limit, self._wait_s, self._what = limit, wait_s, what
        self._owners: dict[str, _Slots] = {}

    @contextlib.asynccontextmanager
    async def slot(self, owner: str) -> AsyncIterator[None]:
        """Hold a slot for as long as the block lasts. Raises over-quota."""
        slots = self._owners.get(owner)
        if slots is None:
            slots = self._owners[owner] = _Slots(asyncio.Semaphore(self._limit))
        slots.users += 1
        try:
            try:
                async with asyncio.timeout(self._wait_s):
                    await slots.free.acquire()
            except TimeoutError:
                detail = f"at most {self._limit} {self._what} of a key at once"
                raise ProblemError(ProblemCode.OVER_QUOTA, detail, retry_after_s=1.0) from None
            try:
                yield
            finally:
                slots.free.release()
        finally:
            slots.users -= 1
            if not slots.users:
                del self._owners[owner]
