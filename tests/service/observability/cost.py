"""What observing costs: ``python -m tests.service.observability.cost``.

Microseconds that the counters and the spans of one frame take, and the processor time of the longest turn of the
event loop while ``/metrics`` is told.
"""

from __future__ import annotations

import asyncio
import os
import time

from service.app import create_app
from service.observability.metrics import Metrics
from service.observability.stages import Stages
from service.observability.tracing import Tracing
from service.protocol.problems import CATALOGUE
from service.settings import Settings

FRAMES = 20_000
STAGES = Stages(0.00004, 0.0, 0.0004, 0.001, 0.001)


def frame_us(metrics: Metrics) -> float:
    """Everything that is counted of a frame on a stream that is answered."""
    span = metrics.tracing.begin("GET", {}) if metrics.tracing else None
    begun = time.process_time()
    for seq in range(FRAMES):
        metrics.stream_frame(60_000)
        metrics.frame(STAGES, "a-session", seq, span, live=False, sent_s=0.00005)
    return (time.process_time() - begun) / FRAMES * 1e6


async def longest_turn_ms(rounds: int = 50) -> tuple[float, float]:
    """The longest and the median of the longest turns of the loop in ``rounds`` of telling all metrics."""
    app = create_app(Settings(lanes=os.cpu_count() or 1))
    service = app.state.service
    for code in CATALOGUE:
        service.metrics.refused_message(code, frame=True)
    for path in range(25):
        for status in (200, 400, 404, 429, 503):
            service.metrics.requests.labels(method="GET", path=f"/{path}", status=status).inc()
    handle = asyncio.events.Handle._run
    turns: list[float] = []

    def timed(self: asyncio.events.Handle) -> None:
        begun = time.thread_time()
        handle(self)
        turns.append(time.thread_time() - begun)

    longest = []
    asyncio.events.Handle._run = timed  # type: ignore[method-assign]
    try:
        for _ in range(rounds):
            turns.clear()
            await service.exporter.text("")
            longest.append(max(turns) * 1e3)
    finally:
        asyncio.events.Handle._run = handle  # type: ignore[method-assign]
    return max(longest), sorted(longest)[rounds // 2]


def main() -> None:
    """Print them."""
    print(f"counters of a frame      {frame_us(Metrics()):6.1f} us")
    for ratio in (0.0, 0.01, 1.0):
        tracing = Tracing("http://127.0.0.1:9", ratio, "0")
        tracing._provider._active_span_processor._span_processors = ()  # nothing is sent from here
        print(f"with spans of {ratio:4.0%}       {frame_us(Metrics(tracing)):6.1f} us")
    worst, median = asyncio.run(longest_turn_ms())
    print(f"longest turn, /metrics   {median:6.2f} ms median, {worst:.2f} ms at most")


if __name__ == "__main__":
    main()
