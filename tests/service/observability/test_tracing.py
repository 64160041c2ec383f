"""Spans, as a collector gets them: a real OTLP/HTTP receiver, a real server, real frames."""

from __future__ import annotations

import gzip
import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import pairwise
from typing import Any

import httpx2
import pytest

from service.client import Client, Problem
from service.load.clips import Clip
from service.load.own import OwnServer
from tests.conftest import require

try:
    from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
except ModuleNotFoundError:
    ExportTraceServiceRequest = None

TRACE, PARENT = "0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331"
NOT_LOADED = """
import sys
from service.app import create_app
from service.settings import Settings
create_app(Settings(lanes=1))
print([name for name in sys.modules if name.startswith("opentelemetry.sdk") or "otlp" in name])
"""


@dataclass
class Collector:
    """What has come in."""

    url: str = ""
    spans: list[Any] = field(default_factory=list)
    services: set[str] = field(default_factory=set)

    def take(self, body: bytes) -> None:
        request = ExportTraceServiceRequest.FromString(body)
        for resource in request.resource_spans:
            named = {pair.key: pair.value.string_value for pair in resource.resource.attributes}
            self.services.add(named["service.name"])
            self.spans += [span for scope in resource.scope_spans for span in scope.spans]

    def named(self, name: str) -> list[Any]:
        return [span for span in self.spans if span.name == name]

    def children(self, parent: Any) -> dict[str, Any]:
        return {span.name: span for span in self.spans if span.parent_span_id == parent.span_id}


@pytest.fixture
def collector() -> Iterator[Collector]:
    require(ExportTraceServiceRequest is not None, "the extra otel is not installed")
    collector = Collector()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            assert self.path == "/v1/traces"
            collector.take(gzip.decompress(body) if self.headers.get("Content-Encoding") == "gzip" else body)
            self.send_response(200)
            self.send_header("Content-Type", "application/x-protobuf")
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None: ...

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    collector.url = f"http://127.0.0.1:{server.server_port}"
    yield collector
    server.shutdown()
    thread.join()
    server.server_close()


def attributes(span: Any) -> dict[str, Any]:
    return {pair.key: pair.value.string_value or pair.value.int_value for pair in span.attributes}


def test_calls_and_frames_arrive_with_their_stages(collector: Collector, own_server: Any, clip: Clip) -> None:
    server: OwnServer = own_server(otlp_endpoint=collector.url, trace_ratio=1)
    with Client(server.url) as client:
        session = client.create(clip.frames[0], box=clip.box)
        list(session.stream(clip.frames[1:6], mode="lossless"))
        with pytest.raises(Problem):
            session.track(b"no image")
        answer = httpx2.post(
            f"{server.url}/v1/sessions/{session.id}/frames",
            content=clip.frames[6],
            headers={"Content-Type": "image/jpeg", "traceparent": f"00-{TRACE}-{PARENT}-01"},
        )
        assert answer.status_code == 200
        exposed = httpx2.get(f"{server.url}/metrics", headers={"Accept": "application/openmetrics-text; version=1.0.0"})
    logged = server.log
    server.stop()  # sends what is left

    assert collector.services == {"mfcmt"}
    [made] = collector.named("POST /v1/sessions")
    assert attributes(made)["http.response.status_code"] == 201
    [stream] = collector.named("GET /v1/sessions/{session_id}/stream")
    frames = collector.named("frame")
    assert [attributes(frame)["mfcmt.seq"] for frame in frames] == [1, 2, 3, 4, 5, 7]
    assert {attributes(frame)["mfcmt.session"] for frame in frames} == {session.id}
    for frame in frames[:5]:
        assert [link.span_id for link in frame.links] == [stream.span_id]
        stages = collector.children(frame)
        assert list(stages) == ["receive", "queue", "lane", "send"]
        assert list(collector.children(stages["lane"])) == ["decode", "track"]
        ordered = [stages[name] for name in ("receive", "queue", "lane", "send")]
        for earlier, later in pairwise(ordered):
            assert earlier.end_time_unix_nano == later.start_time_unix_nano
        assert frame.start_time_unix_nano == ordered[0].start_time_unix_nano
        assert abs(frame.end_time_unix_nano - ordered[-1].end_time_unix_nano) < 1000
    assert len({frame.trace_id for frame in frames}) == 6

    refused, posted = collector.named("POST /v1/sessions/{session_id}/frames")
    assert attributes(refused)["error.type"] == "unsupported-image"
    assert (posted.trace_id.hex(), posted.parent_span_id.hex()) == (TRACE, PARENT)
    assert frames[5].parent_span_id == posted.span_id
    assert f'trace_id="{TRACE}"' in exposed.text
    created = next(line for line in map(json.loads, logged.splitlines()) if line.get("path") == "/v1/sessions")
    assert created["trace_id"] == made.trace_id.hex()


def test_the_share_decides_and_a_caller_may_refuse(collector: Collector, own_server: Any, clip: Clip) -> None:
    server: OwnServer = own_server(otlp_endpoint=collector.url, trace_ratio=0)
    sampled, unsampled = f"00-{TRACE}-{PARENT}-01", f"00-{TRACE[::-1]}-{PARENT}-00"
    for parent in ({"traceparent": sampled}, {"traceparent": unsampled}, {"traceparent": "nonsense"}, {}):
        assert httpx2.get(f"{server.url}/livez", headers=parent).status_code == 200
    with Client(server.url) as client:
        session = client.create(clip.frames[0], box=clip.box)
        list(session.stream(clip.frames[1:4], mode="lossless"))
    server.stop()
    assert [span.trace_id.hex() for span in collector.spans] == [TRACE]


def test_a_collector_that_is_gone_harms_nothing(own_server: Any, clip: Clip) -> None:
    server: OwnServer = own_server(otlp_endpoint="http://127.0.0.1:9", trace_ratio=1)
    with Client(server.url) as client:
        session = client.create(clip.frames[0], box=clip.box)
        assert len(list(session.stream(clip.frames[1:11], mode="lossless"))) == 10


def test_off_means_that_nothing_of_it_is_loaded() -> None:
    done = subprocess.run([sys.executable, "-c", NOT_LOADED], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
