"""The metrics in Prometheus' text formats, written without holding up a frame."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Iterable, Iterator
from importlib.metadata import version
from itertools import chain
from typing import Protocol

from prometheus_client import CollectorRegistry, PlatformCollector, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from ..lanes.interface import Lanes, LaneUsage
from .metrics import Metrics

OPENMETRICS_END = b"# EOF\n"
HEAD = re.compile(rb"\A(#[^\n]*\n)+")
SAMPLES_AT_ONCE = 32


class RecoveryBytes(Protocol):
    """The bytes that are kept to restore sessions, and their limit."""

    limit: int
    checkpoints: int
    frames: int


class PrometheusExporter:
    """Writes the metrics of the service, with the present state of the service and its processes."""

    def __init__(
        self, metrics: Metrics, sessions: Callable[[], int], capacity: int, lanes: Lanes, kept: RecoveryBytes
    ) -> None:
        self._metrics, self._sessions, self._capacity, self._lanes = metrics, sessions, capacity, lanes
        self._kept = kept
        self._making: dict[str, asyncio.Future[tuple[bytes, str]]] = {}
        self._process = CollectorRegistry()
        ProcessCollector(registry=self._process)
        PlatformCollector(registry=self._process)

    async def text(self, accept: str) -> tuple[bytes, str]:
        """Return all metrics and their media type; calls at the same time share one result."""
        wanted = choose_encoder(accept)[1]
        making = self._making.get(wanted)
        if making is None:
            making = self._making[wanted] = asyncio.ensure_future(self._text(accept))
            making.add_done_callback(lambda _: self._making.pop(wanted))
        return await asyncio.shield(making)

    async def _text(self, accept: str) -> tuple[bytes, str]:
        """Return all metrics and their media type: OpenMetrics, with exemplars, if ``accept`` names it.

        In one piece this would hold up the event loop for a millisecond or two. So the questions to the system are
        asked in a thread, and the loop does other work after every few samples.
        """
        encode, media_type = choose_encoder(accept)
        process, usage = await asyncio.to_thread(lambda: (list(self._process.collect()), self._lanes.usage()))
        parts = []
        for family in chain(self._metrics.registry.collect(), self._now(usage), process):
            # Prometheus does not use the times at which series began, and they would be half of all lines.
            samples = [sample for sample in family.samples if not sample.name.endswith("_created")]
            for at in range(0, len(samples), SAMPLES_AT_ONCE):
                family.samples = samples[at : at + SAMPLES_AT_ONCE]
                text = encode(_One(family)).removesuffix(OPENMETRICS_END)
                parts.append(text if at == 0 else HEAD.sub(b"", text))
                await asyncio.sleep(0)
        if "openmetrics" in media_type:
            parts.append(OPENMETRICS_END)
        return b"".join(parts), media_type

    def _now(self, usage: list[LaneUsage]) -> Iterator[Metric]:
        yield GaugeMetricFamily("mfcmt_sessions_active", "Sessions that live now", self._sessions())
        yield GaugeMetricFamily("mfcmt_sessions_capacity", "Maximum of sessions", self._capacity)
        rss = GaugeMetricFamily("mfcmt_lane_rss_bytes", "Resident memory of a lane", labels=["lane"])
        cpu = CounterMetricFamily("mfcmt_lane_cpu_seconds", "CPU time of a lane's process", labels=["lane"])
        keys = GaugeMetricFamily("mfcmt_lane_sessions", "Sessions in a lane", labels=["lane"])
        ready = GaugeMetricFamily("mfcmt_lane_ready", "1 when a lane takes sessions", labels=["lane"])
        failing = GaugeMetricFamily("mfcmt_lane_failing", "1 when a lane dies again and again", labels=["lane"])
        statuses = self._lanes.status()
        for status in statuses:
            keys.add_metric([str(status.lane)], status.keys)
            ready.add_metric([str(status.lane)], float(status.ready))
            failing.add_metric([str(status.lane)], float(status.failing))
        for used in usage:
            rss.add_metric([str(used.lane)], used.rss_bytes)
            cpu.add_metric([str(used.lane)], used.cpu_s)
        yield from (rss, cpu, keys, ready, failing)
        kept = GaugeMetricFamily("mfcmt_recovery_bytes", "Bytes kept to restore sessions", labels=["what"])
        kept.add_metric(["checkpoints"], self._kept.checkpoints)
        kept.add_metric(["frames"], self._kept.frames)
        yield kept
        yield GaugeMetricFamily(
            "mfcmt_recovery_bytes_limit", "Maximum of bytes kept to restore sessions", self._kept.limit
        )
        versions = next((status.versions for status in statuses if status.versions), {})
        names = ["version", "opencv", "numpy"]
        build = GaugeMetricFamily("mfcmt_build_info", "Versions; always 1", labels=names)
        build.add_metric([version("mfcmt"), versions.get("opencv", ""), versions.get("numpy", "")], 1)
        yield build


class _One(Collector):
    """A collector of one metric."""

    def __init__(self, family: Metric) -> None:
        self._family = family

    def collect(self) -> Iterable[Metric]:
        """Return the metric."""
        return (self._family,)
