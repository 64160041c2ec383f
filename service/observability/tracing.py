"""OpenTelemetry spans of calls and frames. Imported only if ``MFCMT_OTLP_ENDPOINT`` is set (extra ``otel``)."""

from __future__ import annotations

import time
from collections.abc import Mapping

from opentelemetry.context import Context
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from opentelemetry.sdk.trace.sampling import ParentBased, TraceIdRatioBased
from opentelemetry.trace import Link, Span, SpanKind, Status, StatusCode, format_trace_id, set_span_in_context
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

from .stages import Stages

SECOND_NS = 1_000_000_000
# Time for one batch with its retries. When the service stops, it waits for the last batch.
EXPORT_S = 2.0


class Tracing:
    """Makes spans and sends them to ``endpoint``/v1/traces, in batches and from a thread of its own.

    ``ratio`` is the share of calls and frames that begin a trace. A call with a ``traceparent`` header follows that.
    """

    def __init__(self, endpoint: str, ratio: float, version: str) -> None:
        resource = Resource.create({"service.name": "mfcmt", "service.version": version})
        self._provider = TracerProvider(resource=resource, sampler=ParentBased(TraceIdRatioBased(ratio)))
        exporter = OTLPSpanExporter(endpoint=f"{endpoint.rstrip('/')}/v1/traces", timeout=EXPORT_S)
        self._provider.add_span_processor(BatchSpanProcessor(exporter))
        self._tracer = self._provider.get_tracer("mfcmt", version)
        self._propagator = TraceContextTextMapPropagator()

    def begin(self, method: str, headers: Mapping[str, str]) -> Span:
        """Return the span of a call or handshake; :meth:`end` gives it its name."""
        context = self._propagator.extract(headers, Context())
        return self._tracer.start_span(method, context, SpanKind.SERVER)

    def id(self, span: Span) -> str | None:
        """Return the id of the span's trace; None if the trace is not recorded."""
        return format_trace_id(span.get_span_context().trace_id) if span.is_recording() else None

    def end(self, span: Span, method: str, route: str, status: int, problem: str | None) -> None:
        """End the span of a call that was answered."""
        if span.is_recording():
            span.update_name(f"{method} {route}")
            span.set_attributes(
                {"http.request.method": method, "http.route": route, "http.response.status_code": status}
            )
            if problem is not None:
                span.set_attribute("error.type", problem)
            if status >= 500:
                span.set_status(Status(StatusCode.ERROR))
        span.end()

    def frame(self, stages: Stages, sent_s: float, session: str, seq: int, within: Span, *, live: bool) -> str | None:
        """Record a frame whose last stage ends now. Return the id of its trace; None if the trace is not recorded.

        With ``live``, ``within`` is the span of the call that brought the frame, and the parent of the frame's span.
        Without, it is the ended span of the stream's handshake, to which the spans of its many frames are linked.
        """
        length = int((sum(stages) + sent_s) * SECOND_NS)
        at = time.time_ns() - length
        parent = set_span_in_context(within, Context()) if live else Context()
        links = [] if live else [Link(within.get_span_context())]
        attributes: dict[str, str | int] = {"mfcmt.session": session, "mfcmt.seq": seq}
        span = self._tracer.start_span("frame", parent, attributes=attributes, links=links, start_time=at)
        trace_id = self.id(span)
        if trace_id is None:
            return None
        end = at + length
        at = self._part(span, "receive", at, stages.receive)[1]
        at = self._part(span, "queue", at, stages.queue)[1]
        lane, lane_end = self._part(span, "lane", at, stages.transit + stages.decode + stages.track)
        # The clocks of front and lane are not compared: the lane's work is shown in the middle of the round trip.
        at = self._part(lane, "decode", at + int(stages.transit / 2 * SECOND_NS), stages.decode)[1]
        self._part(lane, "track", at, stages.track)
        if sent_s:
            self._part(span, "send", lane_end, sent_s)
        span.end(end)
        return trace_id

    def _part(self, parent: Span, name: str, start: int, length_s: float) -> tuple[Span, int]:
        end = start + int(length_s * SECOND_NS)
        part = self._tracer.start_span(name, set_span_in_context(parent, Context()), start_time=start)
        part.end(end)
        return part, end

    def stop(self) -> None:
        """Send the remaining spans. This takes as long as the collector does, up to the exporter's limit."""
        self._provider.shutdown()
