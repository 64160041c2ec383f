"""The lag of the event loop."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from prometheus_client import Histogram

EVERY_S = 0.05
WINDOW_S = 30.0


class Lag:
    """Measures how late a timer of the event loop is: a histogram, and the maximum of the last 30 to 60 seconds."""

    def __init__(self, histogram: Histogram, clock: Callable[[], float] = time.monotonic) -> None:
        self._histogram, self._clock = histogram, clock
        self._since = clock()
        self._before = self._now = 0.0

    def observe(self, late_s: float) -> None:
        """Count a timer that was ``late_s`` seconds late."""
        self._histogram.observe(late_s)
        self._turn()
        self._now = max(self._now, late_s)

    @property
    def highest_s(self) -> float:
        """The maximum of the last 30 to 60 seconds, in seconds. A scrape every 15 or 30 seconds sees every stall."""
        self._turn()
        return max(self._before, self._now)

    async def watch(self) -> None:
        """Measure every 50 ms while the service runs."""
        while True:
            due = time.monotonic() + EVERY_S
            await asyncio.sleep(EVERY_S)
            self.observe(max(0.0, time.monotonic() - due))

    def _turn(self) -> None:
        passed = self._clock() - self._since
        if passed >= WINDOW_S:
            self._before = self._now if passed < 2 * WINDOW_S else 0.0
            self._now, self._since = 0.0, self._clock()
