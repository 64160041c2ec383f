"""Makes a session once, whichever nodes the client asks with the same Idempotency-Key."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass

import msgpack
import redis

from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..sessions.idempotency import content_digest
from .asking import Asking, StoreAway
from .redis_store import key


@dataclass(frozen=True, slots=True)
class Creation:
    """The content that a key was used with, the process that makes or made the session, and its id once it is made."""

    digest: bytes
    holder: str
    sid: str = ""


class Creations:
    """The Idempotency-Keys of all nodes, each for ``ttl_s`` seconds; ``holder`` names this process."""

    def __init__(self, client: redis.Redis, ask: Asking, holder: str, ttl_s: float) -> None:
        self._client, self._ask, self._holder, self._ttl_ms = client, ask, holder, int(ttl_s * 1e3)

    async def once(
        self,
        owner: str,
        name: str,
        data: bytes | memoryview,
        rest: str,
        make: Callable[[], Awaitable[str]],
        follow: Callable[[str, Creation], Awaitable[str | None]],
    ) -> str:
        """Return the id of what ``make`` makes; if a call with this key came before, what ``follow`` says.

        ``follow`` returns None where the process that began is gone before it was done. While Redis is away, this
        node makes it without asking. Raises bad-request if the key came with other content.
        """
        place = key("creation", f"{owner} {name}")
        mine = Creation(await asyncio.to_thread(content_digest, data, rest), self._holder)
        try:
            known = await self._ask(self._begin, place, mine)
        except StoreAway:
            return await make()
        if known is not None:
            if known.digest != mine.digest:
                raise ProblemError(ProblemCode.BAD_REQUEST, "the Idempotency-Key was used with another body")
            if (sid := await follow(owner, known)) is not None:
                return sid
        made = ""
        try:
            made = await make()
        finally:
            with suppress(StoreAway):
                await self._ask(self._end, place, Creation(mine.digest, self._holder, made))
        return made

    def _begin(self, place: str, mine: Creation) -> Creation | None:
        found = self._client.set(place, _packed(mine), nx=True, get=True, px=self._ttl_ms)
        return None if found is None else Creation(*msgpack.unpackb(found))

    def _end(self, place: str, made: Creation) -> None:
        if made.sid:
            self._client.set(place, _packed(made), px=self._ttl_ms)
        else:
            self._client.delete(place)


def _packed(creation: Creation) -> bytes:
    packed: bytes = msgpack.packb((creation.digest, creation.holder, creation.sid))
    return packed
