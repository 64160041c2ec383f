"""How late the event loop is."""

from __future__ import annotations

import asyncio

from prometheus_client import Histogram

EVERY_S = 0.5


async def watch_lag(histogram: Histogram) -> None:
    """Observe the lateness of a timer, for as long as the service runs."""
    loop = asyncio.get_running_loop()
    while True:
        due = loop.time() + EVERY_S
        await asyncio.sleep(EVERY_S)
        histogram.observe(max(0.0, loop.time() - due))
