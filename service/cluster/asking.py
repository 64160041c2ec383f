"""Questions to Redis, in threads, and whether it answers."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import ParamSpec, TypeVar

import redis
import structlog

T = TypeVar("T")
P = ParamSpec("P")

THREADS = 4
# While Redis is away, calls that need it do not all wait for it.
ASK_AGAIN_S = 0.5

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.cluster")


class StoreAway(Exception):
    """Redis does not answer."""


class Asking:
    """Asks Redis beside the event loop, and notices when it goes away and comes back."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(THREADS, "mfcmt-store")
        self._failed_at: float | None = None
        self._answered_at = time.monotonic()

    @property
    def is_away(self) -> bool:
        """Whether Redis did not answer when it was asked last."""
        return self._failed_at is not None

    @property
    def away_s(self) -> float:
        """For how long Redis has not answered; 0 while it does."""
        return 0.0 if self._failed_at is None else time.monotonic() - self._answered_at

    async def __call__(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Do what waits for Redis in a thread. Raises StoreAway."""
        if self._failed_at is not None and time.monotonic() - self._failed_at < ASK_AGAIN_S:
            raise StoreAway("Redis does not answer")
        try:
            done = await asyncio.get_running_loop().run_in_executor(self._threads, lambda: work(*args, **kwargs))
        except (redis.RedisError, OSError) as failed:
            if self._failed_at is None:
                log.error("the store is away: streams go on", fault=str(failed))
            self._failed_at = time.monotonic()
            raise StoreAway(f"Redis does not answer ({failed})") from failed
        if self._failed_at is not None:
            log.info("the store is back", away_s=round(self.away_s, 1))
        self._failed_at, self._answered_at = None, time.monotonic()
        return done

    def close(self) -> None:
        """Ask no more."""
        self._threads.shutdown(wait=False)
