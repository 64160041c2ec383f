"""Makes a session once, however often the client asks with the same Idempotency-Key."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from .ttl_cache import TTLCache


@dataclass(frozen=True, slots=True)
class _Creation:
    """The content that a key was used with, and the future of the session's id.

    It is the id and not the session, because this must not keep a session alive that has ended.
    """

    fingerprint: bytes
    session: asyncio.Future[str]


class IdempotentCreations:
    """Remembers at most ``limit`` keys of each owner, each for ``ttl_s`` seconds."""

    def __init__(self, limit: int, ttl_s: float, clock: Callable[[], float]) -> None:
        self._known: TTLCache[_Creation] = TTLCache(limit, ttl_s, clock)

    async def once(
        self, owner: str, key: str | None, data: bytes | memoryview, rest: str, make: Callable[[], Awaitable[str]]
    ) -> str:
        """Return what ``make`` makes, now or when the owner's ``key`` came first.

        Raises bad-request if the key came before with other ``data`` or ``rest``, and what ``make`` raises.
        """
        if key is None:
            return await make()
        name = f"{owner} {key}"
        fingerprint = await asyncio.to_thread(content_digest, data, rest)
        if (known := self._find(name, fingerprint)) is not None:
            return await asyncio.shield(known)
        future: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._known.put(owner, name, _Creation(fingerprint, future))
        try:
            made = await make()
        except BaseException as failed:
            # A refused creation may be tried again; calls that wait for this one get the same refusal.
            self._known.pop(name)
            problem = failed if isinstance(failed, ProblemError) else ProblemError(ProblemCode.INTERNAL, "failed")
            future.set_exception(problem)
            future.exception()
            raise
        future.set_result(made)
        return made

    async def repeated(
        self, owner: str, key: str | None, data: bytes | memoryview, rest: str
    ) -> asyncio.Future[str] | None:
        """Return the future of an earlier call with the same key and content, or None if this is the first.

        With it a repeated call need not keep its body while it waits. Raises bad-request like :meth:`once`.
        """
        name = f"{owner} {key}"
        if key is None or self._known.get(name) is None:
            return None
        return self._find(name, await asyncio.to_thread(content_digest, data, rest))

    def sweep(self) -> None:
        """Forget keys that have expired."""
        self._known.sweep()

    def _find(self, name: str, fingerprint: bytes) -> asyncio.Future[str] | None:
        known = self._known.get(name)
        if known is None:
            return None
        if known.fingerprint != fingerprint:
            raise ProblemError(ProblemCode.BAD_REQUEST, "the Idempotency-Key was used with another body")
        return known.session


def content_digest(data: bytes | memoryview, rest: str) -> bytes:
    """Return a digest of the content of a call."""
    digest = hashlib.sha256(rest.encode())
    digest.update(data)
    return digest.digest()
