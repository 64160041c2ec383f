"""The metrics of the service. They follow Prometheus' conventions; no label has a value per session or client."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram

from ..protocol.enums import CloseCode, EndReason, LaneLoss, Preset, Status
from ..protocol.problems import CATALOGUE
from ..sessions.byte_budget import ByteBudget
from .lag import Lag
from .per_frame import FrameCounter, FrameHistogram
from .stages import Stages

if TYPE_CHECKING:
    from opentelemetry.trace import Span

    from .tracing import Tracing


SECONDS = (0.0005, 0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.02, 0.03, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5)
CONFIDENCES = tuple(tenth / 10 for tenth in range(1, 11))
SIZES = tuple(2**n for n in range(16, 27))
# Stages in the front take tens of microseconds unless something is wrong.
SHORT_SECONDS = (0.00005, 0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.05, 0.25, 1.0)
DROPS = ("superseded", "frame-too-large", "unsupported-image", "frame-undecodable", "frame-size-changed", "bad-region")
CAUSES = (LaneLoss.DIED, LaneLoss.HUNG, LaneLoss.MEMORY, LaneLoss.START)
WHYS = ("frames", "bytes", "budget", "stop", "move")
RETURNS = (LaneLoss.DIED, LaneLoss.HUNG, LaneLoss.MEMORY, LaneLoss.RESTART, LaneLoss.FAULT)
CLOSES = (
    CloseCode.SESSION_CLOSED,
    CloseCode.INTERNAL,
    CloseCode.RESTART,
    CloseCode.UNREADABLE,
    CloseCode.UNAUTHENTICATED,
    CloseCode.IDLE,
    CloseCode.ATTACHED_ELSEWHERE,
    CloseCode.SESSION_GONE,
    CloseCode.RATE_LIMITED,
)


class Metrics:
    """All metrics of one service, in a registry of their own, and its ``tracing`` if that is on."""

    def __init__(self, tracing: Tracing | None = None) -> None:
        self.tracing = tracing
        self.registry = CollectorRegistry()

        self._make_admission()
        self._make_frames()
        self._make_streams_and_lanes()
        self._make_stages()
        self._make_recovery()

    def _counter(self, name: str, text: str, **known: Iterable[str]) -> Counter:
        """Return a counter. Values of a single label that are ``known`` are there from the start, at zero.

        A rate over a series that begins with the first fault would miss that fault.
        """
        made = Counter(name, text, tuple(known), registry=self.registry)
        for value in next(iter(known.values()), ()):
            made.labels(value)
        return made

    def _seconds(self, name: str, text: str, buckets: tuple[float, ...] = SECONDS) -> Histogram:
        return Histogram(name, text, buckets=buckets, registry=self.registry)

    def _of_frames(self, name: str, text: str, buckets: tuple[float, ...] = SECONDS) -> FrameHistogram:
        return FrameHistogram(name, text, buckets, self.registry)

    def _sizes(self, name: str, text: str) -> Histogram:
        return Histogram(name, text, buckets=SIZES, registry=self.registry)

    def _make_admission(self) -> None:
        counter = self._counter
        self.sessions_created = counter("mfcmt_sessions_created_total", "Sessions created or restored", preset=Preset)
        self.sessions_closed = counter("mfcmt_sessions_closed_total", "Sessions ended", reason=EndReason)
        self.refused_sessions = counter(
            "mfcmt_admission_rejected_total",
            "Sessions refused because no place was free",
            reason=("at-capacity", "draining", "over-quota"),
        )

    def _make_frames(self) -> None:
        counter = self._counter
        self.frames_received = FrameCounter(
            "mfcmt_frames_received_total", "Frame messages and calls", self.registry, "via", ("stream", "http")
        )
        self.frame_bytes = FrameCounter("mfcmt_frame_bytes_total", "Encoded bytes of frames received", self.registry)
        self.frames_dropped = counter("mfcmt_frames_dropped_total", "Frames that were not tracked", reason=DROPS)
        self.problems = counter("mfcmt_problems_total", "Refusals sent to clients", code=CATALOGUE)
        self.requests = counter("mfcmt_http_requests_total", "HTTP calls answered", method=(), path=(), status=())

    def _make_streams_and_lanes(self) -> None:
        counter = self._counter
        self.streams = Gauge("mfcmt_ws_connections", "Attached streams", registry=self.registry)
        self.stream_closes = counter(
            "mfcmt_ws_closes_total", "Streams closed by the service", code=(str(int(code)) for code in CLOSES)
        )
        self.lane_restarts = counter("mfcmt_lane_restarts_total", "Lanes replaced", cause=CAUSES)

    def _make_stages(self) -> None:
        """Make what a frame's way is measured by, and the event loop."""
        seconds, of_frames = self._seconds, self._of_frames
        self.receive_seconds = of_frames(
            "mfcmt_frame_receive_seconds", "Time from a frame's arrival to the queue: parsing and checks", SHORT_SECONDS
        )
        self.queue_seconds = of_frames(
            "mfcmt_frame_queue_seconds", "Time that a frame waits for the one before it in its session"
        )
        self.transit_seconds = of_frames(
            "mfcmt_frame_transit_seconds", "Time to the lane and back, with the lane's queue"
        )
        self.decode_seconds = of_frames("mfcmt_frame_decode_seconds", "Decoding of a frame")
        self.track_seconds = of_frames("mfcmt_frame_track_seconds", "Tracking of all targets in a frame")
        self._by_stage = (
            self.receive_seconds,
            self.queue_seconds,
            self.transit_seconds,
            self.decode_seconds,
            self.track_seconds,
        )
        self.target_confidence = of_frames(
            "mfcmt_target_confidence", "Confidence of each target in each frame", CONFIDENCES
        )
        self.target_results = FrameCounter(
            "mfcmt_target_results_total", "Targets in tracked frames by their status", self.registry, "status", Status
        )
        self.send_seconds = of_frames(
            "mfcmt_frame_send_seconds", "Writing a stream's result to its socket", SHORT_SECONDS
        )
        self.total_seconds = of_frames("mfcmt_frame_total_seconds", "Time from a frame's arrival to its result")
        self.request_seconds = seconds("mfcmt_http_request_seconds", "HTTP calls, from head to last byte")
        self.loop_lag_seconds = seconds("mfcmt_event_loop_lag_seconds", "How late a timer of the event loop fires")
        self.lag = Lag(self.loop_lag_seconds)
        highest = Gauge(
            "mfcmt_event_loop_lag_max_seconds",
            "Maximum lateness of a timer of the event loop in the last 30 to 60 seconds",
            registry=self.registry,
        )
        highest.set_function(lambda: self.lag.highest_s)

    def _make_recovery(self) -> None:
        counter, seconds, sizes = self._counter, self._seconds, self._sizes
        self.snapshot_bytes = sizes("mfcmt_snapshot_bytes", "Size of snapshots sent to clients")
        self.checkpoint_bytes = sizes("mfcmt_checkpoint_bytes", "Size of checkpoints")
        self.checkpoints = counter("mfcmt_checkpoints_total", "Checkpoints of sessions", reason=WHYS)
        self.checkpoint_seconds = seconds(
            "mfcmt_checkpoint_seconds", "Time from the request of a checkpoint to its bytes"
        )
        self.recoveries = counter("mfcmt_recoveries_total", "Sessions restored in a lane", cause=RETURNS)
        self.recovery_seconds = seconds(
            "mfcmt_recovery_seconds", "Time from the loss of a session's lane to its return"
        )
        self.moves = counter("mfcmt_session_moves_total", "Sessions moved from a full lane to an idle one")
        self.replayed = counter("mfcmt_replayed_operations_total", "Frames and controls repeated in a new lane")
        self.state_write_seconds = seconds("mfcmt_state_write_seconds", "Writes to the state directory")
        self.state_write_failures = counter(
            "mfcmt_state_write_failures_total", "Writes that failed and are tried again"
        )

    def watch_byte_budget(self, budget: ByteBudget) -> None:
        """Export how much of ``budget`` is in use."""
        held = Gauge("mfcmt_under_way_bytes", "Bodies, messages and answers under way", registry=self.registry)
        held.set_function(lambda: budget.held)
        limit = Gauge("mfcmt_under_way_bytes_limit", "Maximum of bytes under way", registry=self.registry)
        limit.set(budget.limit)

    def stream_frame(self, size: int) -> None:
        """Count a frame message of ``size`` bytes."""
        self.frames_received.counts["stream"] += 1
        self.frame_bytes.counts[""] += size

    def http_frame(self, size: int) -> None:
        """Count a frame of ``size`` bytes that came in an HTTP call."""
        self.frames_received.counts["http"] += 1
        self.frame_bytes.counts[""] += size

    def refused_message(self, code: str, *, frame: bool) -> None:
        """Count a refusal on a stream; ``frame``: of a frame."""
        self.problems.labels(code=code).inc()
        if frame:
            self.frames_dropped.labels(reason=code).inc()

    def checkpoint(self, reason: str, size: int, seconds: float) -> None:
        """Count a checkpoint of ``size`` bytes that took ``seconds``."""
        self.checkpoints.labels(reason=reason).inc()
        self.checkpoint_bytes.observe(size)
        self.checkpoint_seconds.observe(seconds)

    def recovered(self, cause: str, operations: int, seconds: float) -> None:
        """Count a restored session that needed ``operations`` repeated and took ``seconds``."""
        self.recoveries.labels(cause=cause).inc()
        self.replayed.inc(operations)
        self.recovery_seconds.observe(seconds)

    def targets(self, targets: Iterable[Mapping[str, Any]]) -> None:
        """Count the targets of one result."""
        for target in targets:
            self.target_confidence.observe(target["confidence"])
            self.target_results.counts[target["status"]] += 1

    def frame(
        self, stages: Stages, session: str, seq: int, within: Span | None, *, live: bool, sent_s: float = 0.0
    ) -> None:
        """Count a tracked frame whose answer was written in ``sent_s``; for the rest see :meth:`Tracing.frame`."""
        trace_id = None
        if self.tracing is not None and within is not None:
            trace_id = self.tracing.frame(stages, sent_s, session, seq, within, live=live)
        FrameHistogram.observe_each(self._by_stage, stages)
        if sent_s:
            self.send_seconds.observe(sent_s)
        exemplar = {"trace_id": trace_id} if trace_id else None
        self.total_seconds.observe(sum(stages), exemplar)
