"""Sessions that are made once, however often the client asks with the same Idempotency-Key."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from ..protocol.problems import ProblemError
from .ttl_cache import TTLCache


@dataclass(frozen=True, slots=True)
class Creation:
    """What a key has been used for: the id, because a session must not outlive its end here."""

    fingerprint: bytes
    session: asyncio.Future[str]


class IdempotentCreations:
    """At most ``most`` keys of each owner are remembered, each for ``seconds``."""

    def __init__(self, most: int, seconds: float, clock: Callable[[], float]) -> None:
        self._known: TTLCache[Creation] = TTLCache(most, seconds, clock)

    async def once(
        self, owner: str, key: str | None, data: bytes, rest: str, make: Callable[[], Awaitable[str]]
    ) -> str:
        """What ``make`` made, now or when the owner's ``key`` came first, with the same ``data`` and ``rest``.

        Raises bad-request for a key that was used with others, and what ``make`` raises.
        """
        if key is None:
            return await make()
        name = f"{owner} {key}"
        fingerprint = await asyncio.to_thread(_fingerprint, data, rest)
        if (known := self._same(name, fingerprint)) is not None:
            return await asyncio.shield(known)
        future: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._known.put(owner, name, Creation(fingerprint, future))
        try:
            made = await make()
        except BaseException as failed:
            # A refused creation may be tried again; whoever waits for this one gets the same answer.
            self._known.pop(name)
            told = failed if isinstance(failed, ProblemError) else ProblemError("internal", "failed")
            future.set_exception(told)
            future.exception()
            raise
        future.set_result(made)
        return made

    async def repeated(self, owner: str, key: str | None, data: bytes, rest: str) -> asyncio.Future[str] | None:
        """What another call with the same key and content waits for, or has; None if this is the first.

        So a repeated call need not keep its body while it waits. Raises bad-request as :meth:`once` does.
        """
        name = f"{owner} {key}"
        if key is None or self._known.get(name) is None:
            return None
        return self._same(name, await asyncio.to_thread(_fingerprint, data, rest))

    def _same(self, name: str, fingerprint: bytes) -> asyncio.Future[str] | None:
        known = self._known.get(name)
        if known is None:
            return None
        if known.fingerprint != fingerprint:
            raise ProblemError("bad-request", "the Idempotency-Key was used with another body")
        return known.session

    def sweep(self) -> None:
        """Forget what is too old."""
        self._known.sweep()


def _fingerprint(data: bytes, rest: str) -> bytes:
    digest = hashlib.sha256(rest.encode())
    digest.update(data)
    return digest.digest()
