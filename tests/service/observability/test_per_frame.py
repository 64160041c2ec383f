"""Counters and histograms of frames, compared with those of prometheus_client."""

from __future__ import annotations

from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.openmetrics import exposition

from service.observability.per_frame import FrameCounter, FrameHistogram

BOUNDS = (0.001, 0.01, 0.5)
AMOUNTS = (0.0, 0.001, 0.0011, 0.01, 0.3, 0.5, 0.50001, 7.0)


def lines(registry: CollectorRegistry) -> list[str]:
    return [line for line in generate_latest(registry).decode().splitlines() if "_created" not in line]


def test_a_histogram_of_frames_is_told_like_any_other() -> None:
    ours, theirs = CollectorRegistry(), CollectorRegistry()
    mine = FrameHistogram("a_seconds", "A time", BOUNDS, ours)
    other = Histogram("a_seconds", "A time", buckets=BOUNDS, registry=theirs)
    assert lines(ours) == lines(theirs)
    for amount in AMOUNTS:
        mine.observe(amount)
        other.observe(amount)
    FrameHistogram.observe_each((mine, mine), (0.5, 0.6))
    other.observe(0.5)
    other.observe(0.6)
    assert lines(ours) == lines(theirs)


def test_the_trace_of_an_amount_stands_at_its_bucket() -> None:
    registry = CollectorRegistry()
    histogram = FrameHistogram("a_seconds", "A time", BOUNDS, registry)
    histogram.observe(0.2, {"trace_id": "abc"})
    told = [line for line in exposition.generate_latest(registry).decode().splitlines() if "abc" in line]
    assert len(told) == 1
    assert told[0].startswith('a_seconds_bucket{le="0.5"} 1.0 # {trace_id="abc"} 0.2 ')


def test_a_counter_of_frames_is_told_like_any_other() -> None:
    ours, theirs = CollectorRegistry(), CollectorRegistry()
    mine = FrameCounter("a_total", "A number", ours, "via", ("stream", "http"))
    other = Counter("a_total", "A number", ("via",), registry=theirs)
    plain, other_plain = FrameCounter("b_total", "Bytes", ours), Counter("b_total", "Bytes", registry=theirs)
    for via in ("stream", "http"):
        other.labels(via)
    assert lines(ours) == lines(theirs)
    mine.counts["http"] += 3
    other.labels("http").inc(3)
    plain.counts[""] += 1000
    other_plain.inc(1000)
    assert lines(ours) == lines(theirs)
