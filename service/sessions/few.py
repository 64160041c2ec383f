"""Work that is large: a few at once of each key, the others wait for their turn."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass

from ..problems import ProblemError


@dataclass(slots=True)
class _Line:
    """The places of one owner and how many use them or wait."""

    places: asyncio.Semaphore
    users: int = 0


class Few:
    """At most ``most`` at once of each owner; who waits longer than ``wait_s`` is refused."""

    def __init__(self, most: int, wait_s: float, what: str) -> None:
        self._most, self._wait_s, self._what = most, wait_s, what
        self._lines: dict[str, _Line] = {}

    @contextlib.asynccontextmanager
    async def turn(self, owner: str) -> AsyncIterator[None]:
        """A place, for as long as the block lasts. Raises over-quota."""
        line = self._lines.get(owner)
        if line is None:
            line = self._lines[owner] = _Line(asyncio.Semaphore(self._most))
        line.users += 1
        try:
            try:
                async with asyncio.timeout(self._wait_s):
                    await line.places.acquire()
            except TimeoutError:
                told = f"at most {self._most} {self._what} of a key at once"
                raise ProblemError("over-quota", told, retry_after_s=1.0) from None
            try:
                yield
            finally:
                line.places.release()
        finally:
            line.users -= 1
            if not line.users:
                del self._lines[owner]
