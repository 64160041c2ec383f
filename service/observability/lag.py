"""How late the event loop is, and how long it is busy at a stretch."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from prometheus_client import Histogram

EVERY_S = 0.05
WINDOW_S = 30.0


class Lag:
    """The lateness of a timer: all of them in ``histogram``, and the highest of the last half minute or minute."""

    def __init__(self, histogram: Histogram, clock: Callable[[], float] = time.monotonic) -> None:
        self._histogram, self._clock = histogram, clock
        self._since = clock()
        self._before = self._now = 0.0

    def observe(self, late_s: float) -> None:
        """One timer was so late."""
        self._histogram.observe(late_s)
        self._turn()
        self._now = max(self._now, late_s)

    @property
    def highest_s(self) -> float:
        """The most of the last 30 to 60 seconds: a scrape every 15 or 30 sees every stall."""
        self._turn()
        return max(self._before, self._now)

    async def watch(self) -> None:
        """Observe for as long as the service runs."""
        while True:
            due = time.monotonic() + EVERY_S
            await asyncio.sleep(EVERY_S)
            self.observe(max(0.0, time.monotonic() - due))

    def _turn(self) -> None:
        passed = self._clock() - self._since
        if passed >= WINDOW_S:
            self._before = self._now if passed < 2 * WINDOW_S else 0.0
            self._now, self._since = 0.0, self._clock()
