"""What is counted of frames and refusals, and how it is told."""

from __future__ import annotations

import asyncio
import re
from typing import Any

import httpx2
import pytest
from prometheus_client import generate_latest
from prometheus_client.openmetrics.parser import text_string_to_metric_families as openmetrics_families
from prometheus_client.parser import text_string_to_metric_families

from service.client import Client, Problem
from service.load.clips import Clip
from service.load.own import OwnServer
from service.observability.exporter import PrometheusExporter
from service.observability.metrics import Metrics
from service.observability.stages import Stages
from service.protocol.enums import Status
from service.protocol.problems import CATALOGUE
from service.sessions.replay_log import RecoveryBudget

STAGES = ("receive", "queue", "transit", "decode", "track")
OPENMETRICS = "application/openmetrics-text; version=1.0.0"


class NoLanes:
    def status(self) -> list[Any]:
        return []

    def usage(self) -> list[Any]:
        return []


def scraped(url: str) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    text = httpx2.get(f"{url}/metrics").text
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


@pytest.mark.parametrize("via", ["stream", "http"])
def test_every_stage_of_every_frame_is_counted(own_server: Any, clip: Clip, via: str) -> None:
    server: OwnServer = own_server()
    with Client(server.url) as client:
        session = client.create(clip.frames[0], box=clip.box)
        before = scraped(server.url)
        frames = clip.frames[1:21]
        results = (
            list(session.stream(frames, mode="lossless"))
            if via == "stream"
            else [session.track(frame) for frame in frames]
        )
        session.close()
    after = scraped(server.url)

    def grown(name: str, **labels: str) -> float:
        key = (name, tuple(sorted(labels.items())))
        return after[key] - before[key]

    assert grown("mfcmt_frames_received_total", via=via) == 20
    assert grown("mfcmt_frame_bytes_total") == sum(map(len, frames))
    assert {grown(f"mfcmt_frame_{stage}_seconds_count") for stage in (*STAGES, "total")} == {20}
    assert grown("mfcmt_frame_send_seconds_count") == (20 if via == "stream" else 0)
    assert grown("mfcmt_target_confidence_count") == 20
    for status in Status:
        count = sum(result.targets[0].status == status for result in results)
        assert grown("mfcmt_target_results_total", status=status) == count
    said = sum(result.targets[0].confidence for result in results)
    assert grown("mfcmt_target_confidence_sum") == pytest.approx(said, abs=1e-6)
    parts = sum(grown(f"mfcmt_frame_{stage}_seconds_sum") for stage in STAGES)
    assert parts == pytest.approx(grown("mfcmt_frame_total_seconds_sum"))
    shown = sum(result.timing.queue_ms + result.timing.decode_ms + result.timing.track_ms for result in results)
    assert parts == pytest.approx(shown / 1e3, abs=1e-4)


async def test_every_refusal_is_counted_by_its_problem(own_server: Any, clip: Clip) -> None:
    server: OwnServer = own_server()

    def refuse() -> None:
        with Client(server.url) as client, httpx2.Client(base_url=server.url) as bare:
            session = client.create(clip.frames[0], box=clip.box)
            with pytest.raises(Problem):
                session.track(b"no image")
            with pytest.raises(Problem):
                session.track(clip.frames[1][:3000])
            assert bare.get("/nothing").status_code == 404
            assert bare.get("/v1/sessions/unknown").status_code == 404
            assert bare.get("/livez", headers={"Origin": "http://elsewhere.example"}).status_code == 403
            assert bare.get("/v1/sessions/unknown/stream", headers={"Upgrade": "websocket"}).status_code == 404

    await asyncio.to_thread(refuse)
    text = httpx2.get(f"{server.url}/metrics").text
    counted = {
        sample.labels["code"]: sample.value
        for family in text_string_to_metric_families(text)
        if family.name == "mfcmt_problems"
        for sample in family.samples
    }
    assert counted.keys() == CATALOGUE.keys()
    expected = {"unsupported-image": 1, "frame-undecodable": 1, "origin-refused": 1, "session-not-found": 1}
    assert {code: counted[code] for code in expected} == expected
    assert counted["not-found"] >= 1
    assert counted["internal"] == 0


async def test_telling_bit_by_bit_tells_the_same() -> None:
    metrics = Metrics()
    for number in range(100):
        metrics.requests.labels(method="GET", path=f"/{number}", status=200).inc(number)
    metrics.frame(Stages(1e-4, 1e-4, 1e-3, 1e-3, 1e-3), "s", 1, None, live=True)
    text, kind = await PrometheusExporter(metrics, lambda: 3, 8, NoLanes(), RecoveryBudget(1)).text("")  # type: ignore[arg-type]
    assert kind.startswith("text/plain")
    began = re.compile(r"(# (HELP|TYPE) )?\w+_created[ {]")
    at_once = [line for line in generate_latest(metrics.registry).decode().splitlines() if not began.match(line)]
    lines = text.decode().splitlines()
    assert lines[: len(at_once)] == at_once
    assert "mfcmt_sessions_active 3.0" in lines


async def test_openmetrics_for_who_asks_for_it() -> None:
    exposition = PrometheusExporter(Metrics(), lambda: 0, 8, NoLanes(), RecoveryBudget(1))  # type: ignore[arg-type]
    text, kind = await exposition.text(OPENMETRICS)
    assert kind.startswith("application/openmetrics-text")
    families = {family.name for family in openmetrics_families(text.decode())}
    assert {"mfcmt_problems", "mfcmt_frame_total_seconds", "mfcmt_sessions_active"} <= families
    assert text.count(b"# EOF") == 1
