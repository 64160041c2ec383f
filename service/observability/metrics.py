"""What the service counts. Names and buckets by Prometheus' conventions; no label grows with sessions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.metadata import version
from typing import Protocol

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    PlatformCollector,
    ProcessCollector,
    generate_latest,
)
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from ..lanes.interface import Lanes


class Kept(Protocol):
    """Bytes that are kept to restore sessions."""

    limit: int
    checkpoints: int
    frames: int


SECONDS = (0.0005, 0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.02, 0.03, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5)
SIZES = tuple(2**n for n in range(16, 27))


class Metrics:
    """All metrics of one service, in a registry of their own."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        PlatformCollector(registry=self.registry)

        def counter(name: str, text: str, *labels: str) -> Counter:
            return Counter(name, text, labels, registry=self.registry)

        def seconds(name: str, text: str) -> Histogram:
            return Histogram(name, text, buckets=SECONDS, registry=self.registry)

        def sizes(name: str, text: str) -> Histogram:
            return Histogram(name, text, buckets=SIZES, registry=self.registry)

        self.sessions_created = counter("mfcmt_sessions_created_total", "Sessions made or restored", "preset")
        self.sessions_closed = counter("mfcmt_sessions_closed_total", "Sessions ended", "reason")
        self.refused_sessions = counter(
            "mfcmt_admission_rejected_total", "Sessions refused for want of a place", "reason"
        )
        self.frames_received = counter("mfcmt_frames_received_total", "Frame messages and calls", "via")
        self.frame_bytes = counter("mfcmt_frame_bytes_total", "Encoded bytes of frames received")
        self.frames_dropped = counter("mfcmt_frames_dropped_total", "Frames that were not tracked", "reason")
        self.problems = counter("mfcmt_problems_total", "Refusals told to clients", "code")
        self.requests = counter("mfcmt_http_requests_total", "HTTP calls answered", "method", "path", "status")
        self.streams = Gauge("mfcmt_ws_connections", "Attached streams", registry=self.registry)
        self.stream_closes = counter("mfcmt_ws_closes_total", "Streams closed by the service", "code")
        self.lane_restarts = counter("mfcmt_lane_restarts_total", "Lanes replaced", "cause")
        self.queue_seconds = seconds("mfcmt_frame_queue_seconds", "From a frame's arrival to its lane, both ways")
        self.decode_seconds = seconds("mfcmt_frame_decode_seconds", "Decoding of a frame")
        self.track_seconds = seconds("mfcmt_frame_track_seconds", "Tracking of all targets in a frame")
        self.total_seconds = seconds("mfcmt_frame_total_seconds", "From a frame's arrival to its result")
        self.request_seconds = seconds("mfcmt_http_request_seconds", "HTTP calls, from head to last byte")
        self.loop_lag_seconds = seconds("mfcmt_event_loop_lag_seconds", "How late a timer of the event loop fires")
        self.snapshot_bytes = sizes("mfcmt_snapshot_bytes", "Size of snapshots handed out")
        self.checkpoint_bytes = sizes("mfcmt_checkpoint_bytes", "Size of checkpoints")
        self.checkpoints = counter("mfcmt_checkpoints_total", "Checkpoints of sessions", "reason")
        self.checkpoint_seconds = seconds("mfcmt_checkpoint_seconds", "From the wish for a checkpoint to its bytes")
        self.recoveries = counter("mfcmt_recoveries_total", "Sessions restored in a lane", "cause")
        self.recovery_seconds = seconds("mfcmt_recovery_seconds", "From a session's loss of its lane to its return")
        self.replayed = counter("mfcmt_replayed_operations_total", "Frames and controls made again in a fresh lane")
        self.state_write_seconds = seconds("mfcmt_state_write_seconds", "Writes to the state directory")
        self.state_write_failures = counter("mfcmt_state_write_failures_total", "Writes that failed, to be tried again")

        self._by_stream = self.frames_received.labels(via="stream")
        self._by_http = self.frames_received.labels(via="http")

    def stream_frame(self, size: int) -> None:
        """A frame message has come."""
        self._by_stream.inc()
        self.frame_bytes.inc(size)

    def http_frame(self, size: int) -> None:
        """A frame has come in a call of its own."""
        self._by_http.inc()
        self.frame_bytes.inc(size)

    def refused_message(self, code: str, *, frame: bool) -> None:
        """A client was told of a problem on its stream."""
        self.problems.labels(code=code).inc()
        if frame:
            self.frames_dropped.labels(reason=code).inc()

    def checkpoint(self, reason: str, size: int, seconds: float) -> None:
        """A session's state was kept."""
        self.checkpoints.labels(reason=reason).inc()
        self.checkpoint_bytes.observe(size)
        self.checkpoint_seconds.observe(seconds)

    def recovered(self, cause: str, operations: int, seconds: float) -> None:
        """A session's state was brought back."""
        self.recoveries.labels(cause=cause).inc()
        self.replayed.inc(operations)
        self.recovery_seconds.observe(seconds)

    def frame(self, queue_s: float, decode_s: float, track_s: float, total_s: float) -> None:
        """One frame was tracked."""
        self.queue_seconds.observe(queue_s)
        self.decode_seconds.observe(decode_s)
        self.track_seconds.observe(track_s)
        self.total_seconds.observe(total_s)

    def observe_service(self, sessions: Callable[[], int], capacity: int, lanes: Lanes, kept: Kept) -> None:
        """Read these whenever the metrics are asked for."""
        self.registry.register(_Service(sessions, capacity, lanes, kept))

    def text(self) -> bytes:
        """The Prometheus text format."""
        return generate_latest(self.registry)


class _Service(Collector):
    def __init__(self, sessions: Callable[[], int], capacity: int, lanes: Lanes, kept: Kept) -> None:
        self._sessions, self._capacity, self._lanes, self._kept = sessions, capacity, lanes, kept

    def collect(self) -> Iterator[Metric]:
        """Gauges as they are now."""
        yield GaugeMetricFamily("mfcmt_sessions_active", "Sessions in the book", self._sessions())
        yield GaugeMetricFamily("mfcmt_sessions_capacity", "Sessions that there is room for", self._capacity)
        rss = GaugeMetricFamily("mfcmt_lane_rss_bytes", "Resident memory of a lane", labels=["lane"])
        cpu = CounterMetricFamily("mfcmt_lane_cpu_seconds", "CPU time of a lane's process", labels=["lane"])
        keys = GaugeMetricFamily("mfcmt_lane_sessions", "Sessions in a lane", labels=["lane"])
        failing = GaugeMetricFamily("mfcmt_lane_failing", "1 when a lane dies again and again", labels=["lane"])
        ready = GaugeMetricFamily("mfcmt_lane_ready", "1 when a lane takes sessions", labels=["lane"])
        statuses = self._lanes.status()
        for status in statuses:
            keys.add_metric([str(status.lane)], status.keys)
            ready.add_metric([str(status.lane)], float(status.ready))
            failing.add_metric([str(status.lane)], float(status.failing))
        for usage in self._lanes.usage():
            rss.add_metric([str(usage.lane)], usage.rss_bytes)
            cpu.add_metric([str(usage.lane)], usage.cpu_s)
        yield from (rss, cpu, keys, ready, failing)
        kept = GaugeMetricFamily("mfcmt_recovery_bytes", "Kept to restore sessions", labels=["what"])
        kept.add_metric(["checkpoints"], self._kept.checkpoints)
        kept.add_metric(["frames"], self._kept.frames)
        yield kept
        yield GaugeMetricFamily("mfcmt_recovery_bytes_limit", "Most that is kept to restore sessions", self._kept.limit)
        told = next((status.versions for status in statuses if status.versions), {})
        names = ["version", "opencv", "numpy"]
        build = GaugeMetricFamily("mfcmt_build_info", "Versions; always 1", labels=names)
        build.add_metric([version("mfcmt"), told.get("opencv", ""), told.get("numpy", "")], 1)
        yield build
