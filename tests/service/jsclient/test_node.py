"""The JavaScript client in Node against a real server, beside the Python client and the library."""

from __future__ import annotations

import asyncio
import os
import signal
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from service.client import AsyncClient, Result
from service.load.clips import Clip
from service.load.own import OwnServer
from tests.service.live.cable import Cable
from tests.service.live.conftest import Serve, watch
from tests.service.live.rollout import Rollout
from tests.service.live.test_main_job import in_process

from .conftest import Scenario

KEY = "a-key-of-the-back-end-0123456789"


def without_timing(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{name: value for name, value in result.items() if name != "timing"} for result in results]


async def through_python(url: str, clip: Clip, boxes: list[tuple[float, ...]]) -> list[Result]:
    async with AsyncClient(url) as client, await client.create(clip.frames[0], boxes=boxes) as session:
        return [result async for result in session.stream(clip.frames[1:], mode="lossless")]


@pytest.mark.parametrize("codec", ["json", "msgpack"])
async def test_boxes_are_those_of_the_python_client(
    server: OwnServer, clip: Clip, scenario: Scenario, codec: str
) -> None:
    """Number for number, and those of the library in process."""
    with watch(server):
        report = await scenario("stream", server.url, stream={"mode": "lossless", "codec": codec})
    ours = await through_python(server.url, clip, [clip.box])
    said = in_process(clip, [clip.box])
    assert len(report["results"]) == len(ours) == len(said)
    for theirs, result, one in zip(report["results"], ours, said, strict=True):
        target = theirs["targets"][0]
        assert tuple(target["box"]) == result.target.box == one[0].box
        assert target["status"] == result.target.status
        assert target["scale"] == result.target.scale
        assert target["psr"] == result.target.psr
        assert (theirs["seq"], theirs["size"], theirs["dropped"]) == (result.seq, list(result.size), 0)
        assert theirs["region"] == (list(result.region) if result.region else None)
    assert report["statuses"] == ["open", "closed"]
    stats = report["stats"]
    assert stats["sent"] == stats["answered"] == len(said)
    assert stats["bytesSent"] == sum(map(len, clip.frames[1:]))
    assert 0 < stats["latencyP50Ms"] <= stats["latencyP95Ms"]
    assert stats["rate"] > 0
    assert (stats["inFlight"], stats["refused"], stats["reconnects"]) == (0, 0, 0)


async def test_both_subprotocols_say_the_same(server: OwnServer, scenario: Scenario) -> None:
    """Response maps included: bytes in both."""
    report = [
        await scenario("stream", server.url, stream={"mode": "lossless", "codec": codec}, options={"maps": True})
        for codec in ("json", "msgpack")
    ]
    assert without_timing(report[0]["results"]) == without_timing(report[1]["results"])
    assert all(result["timing"] for each in report for result in each["results"])
    assert "fused" in report[0]["results"][0]["targets"][0]["maps"]


@pytest.mark.parametrize("codec", ["json", "msgpack"])
async def test_lossless_keeps_to_its_credit(server: OwnServer, clip: Clip, scenario: Scenario, codec: str) -> None:
    """Sixty frames at once: each waits for its turn, none is refused, none is lost."""
    report = await scenario("flood", server.url, stream={"mode": "lossless", "codec": codec})
    assert report["sent"] == report["seqs"] == list(range(1, len(clip.frames)))
    assert report["stats"]["refused"] == report["stats"]["skipped"] == 0


async def test_latest_skips_what_finds_no_room(server: OwnServer, clip: Clip, scenario: Scenario) -> None:
    report = await scenario("flood", server.url, stream={"mode": "latest"})
    stats = report["stats"]
    assert stats["skipped"] > 0
    assert stats["sent"] + stats["skipped"] == len(clip.frames) - 1
    assert stats["sent"] == stats["answered"] + stats["dropped"]
    assert report["seqs"][-1] == report["most"]


async def test_a_reader_that_rests_is_not_flooded(server: OwnServer, scenario: Scenario) -> None:
    report = await scenario("unread", server.url, count=100)
    assert report["resting"]["canSend"] is False
    assert 64 <= report["resting"]["handed"] < 80
    assert report["seqs"] == list(range(1, 101))


async def test_lossless_tracks_every_frame_once_through_cuts(server: OwnServer, clip: Clip, scenario: Scenario) -> None:
    """Every frame is tracked exactly once and in order, whatever happens to the connection."""
    cuts = 0
    with watch(server):
        async with Cable(server.port) as cable:

            def heard(line: dict[str, Any]) -> None:
                nonlocal cuts
                if line.get("results") in (10, 30, 40):
                    cuts += 1
                    cable.cut()

            report = await scenario("stream", cable.url, heard, stream={"mode": "lossless", "fps": 40})
    assert cuts == 3
    assert report["stats"]["reconnects"] >= 2
    assert "resuming" in report["statuses"]
    said = in_process(clip, [clip.box])
    assert [r["targets"][0]["box"] for r in report["results"]] == [list(one[0].box) for one in said]
    assert all(a["seq"] < b["seq"] for a, b in pairwise(report["results"]))


async def test_latest_goes_on_to_the_newest_frame_through_cuts(
    server: OwnServer, clip: Clip, scenario: Scenario
) -> None:
    async with Cable(server.port) as cable:

        def heard(line: dict[str, Any]) -> None:
            if line.get("results") in (10, 20):
                cable.cut()

        report = await scenario("stream", cable.url, heard, stream={"mode": "latest", "fps": 40, "codec": "msgpack"})
    assert report["stats"]["reconnects"] >= 1
    assert report["results"][-1]["seq"] == report["seq"]
    assert len(report["results"]) > 20


async def test_a_client_takes_over_its_own_dead_connection(server: OwnServer, clip: Clip, scenario: Scenario) -> None:
    """A connection that carries nothing any more and says nothing."""
    async with Cable(server.port) as cable:

        def heard(line: dict[str, Any]) -> None:
            if line.get("results") == 10:
                cable.go_dead()

        stream = {"mode": "lossless", "fps": 30, "stallMs": 1500}
        report = await scenario("stream", cable.url, heard, stream=stream)
    said = in_process(clip, [clip.box])
    assert [r["targets"][0]["box"] for r in report["results"]] == [list(one[0].box) for one in said]
    assert report["stats"]["reconnects"] >= 1


class Restart:
    """Ends a server when the tenth result is there, and starts it again."""

    def __init__(self, server: OwnServer, how: signal.Signals) -> None:
        self._server, self._how = server, how
        self._task: asyncio.Task[None] | None = None

    def heard(self, line: dict[str, Any]) -> None:
        if line.get("results") == 10 and self._task is None:
            self._task = asyncio.create_task(self._restart())

    async def done(self) -> None:
        assert self._task is not None
        await self._task

    async def _restart(self) -> None:
        os.kill(self._server.pid, self._how)
        while self._server.exit_code is None:
            await asyncio.sleep(0.02)
        await asyncio.to_thread(self._server.start)


async def test_a_stream_goes_on_through_a_restart(
    own_server: Serve, clip: Clip, scenario: Scenario, tmp_path: Path
) -> None:
    """Sessions outlive the process: it is told, every frame is answered, box for box."""
    server = own_server(state_dir=tmp_path / "state")
    restart = Restart(server, signal.SIGTERM)
    report = await scenario("stream", server.url, restart.heard, stream={"mode": "lossless", "fps": 40})
    await restart.done()
    said = in_process(clip, [clip.box])
    assert [r["targets"][0]["box"] for r in report["results"]] == [list(one[0].box) for one in said]
    assert [resumed["lostAfter"] for resumed in report["resumed"]] == [None]
    assert report["resumed"][0]["downMs"] > 0
    order = [status for status in report["statuses"] if status != "connecting"]
    assert order[:3] == ["open", "draining", "resuming"]
    assert order[-2:] == ["open", "closed"]


async def test_a_stream_goes_on_after_a_breakdown(
    own_server: Serve, clip: Clip, scenario: Scenario, tmp_path: Path
) -> None:
    """kill -9: every frame is answered, and what is forgotten is told."""
    server = own_server(state_dir=tmp_path / "state", checkpoint_every_frames=5)
    restart = Restart(server, signal.SIGKILL)
    report = await scenario("stream", server.url, restart.heard, stream={"mode": "lossless", "fps": 40})
    await restart.done()
    assert len(report["results"]) == len(clip.frames) - 1
    (resumed,) = report["resumed"]
    assert resumed["lostAfter"] in (None, resumed["seq"])


async def test_a_stream_is_told_that_its_session_did_not_come_back(own_server: Serve, scenario: Scenario) -> None:
    """A server that comes back without the session ends the stream with the reason."""
    server = own_server(drain_grace_s=1.0)
    statuses: list[str] = []
    restart = Restart(server, signal.SIGTERM)

    def heard(line: dict[str, Any]) -> None:
        restart.heard(line)
        if "status" in line:
            statuses.append(line["status"])

    with pytest.raises(AssertionError, match="session-not-found"):
        await scenario("stream", server.url, heard, stream={"mode": "lossless", "fps": 10})
    await restart.done()
    assert [status for status in statuses if status in ("draining", "closed")] == ["draining", "closed"]
    assert "resuming" in statuses


@pytest.mark.parametrize("codec", ["json", "msgpack"])
async def test_controls_and_refusals_in_a_stream_are_told(
    server: OwnServer, clip: Clip, scenario: Scenario, codec: str
) -> None:
    report = await scenario("controls", server.url, codec=codec)
    assert report["added"] == [0, 1]
    assert report["refused"]["code"] == "target-not-found"
    assert report["waited"]
    assert report["corrected"] == pytest.approx(clip.box)
    result = report["result"]
    assert result["ts"] == "mark"
    assert result["targets"][0]["reliable"] is None
    assert result["targets"][1]["reliable"] is not None
    assert report["removed"] == [1]
    assert [0, 1] in report["told"]
    assert report["told"][-1] == [1, 2]
    assert [(p["code"], p["seq"]) for p in report["problems"]] == [("unsupported-image", 2), ("frame-undecodable", 3)]
    assert report["after"] == 4
    assert (report["ended"]["code"], report["done"], report["status"]) == ("stream-ended", True, "closed")


async def test_every_call_gives_what_the_service_answers(server: OwnServer, clip: Clip, scenario: Scenario) -> None:
    with watch(server):
        report = await scenario("calls", server.url)
    assert report["info"]["label"] == "from node"
    assert report["info"]["targets"][0]["box"] == list(clip.box)
    assert (report["result"]["seq"], report["result"]["ts"]) == (1, 17.5)
    assert report["added"]["target"]["id"] == 1
    assert report["corrected"]["target"]["box"] == list(clip.box)
    assert [target["id"] for target in report["again"]["targets"]] == [0]
    assert report["id"] in report["listed"]
    assert [each["seq"] for each in report["trajectory"]] == [0, 1]
    assert [each["seq"] for each in report["later"]] == [1]
    assert report["texts"]["csv"].startswith("seq,ts,target,x,y,w,h")
    assert len(report["texts"]["otb"].splitlines()) == 2
    assert len(report["texts"]["mot"].splitlines()) == 2
    assert report["restored"]["seq"] == 1
    assert report["restored"]["id"] != report["id"]
    assert report["one"] == report["other"]
    assert set(report["ticket"]) == {"ticket", "expires_at"}
    assert report["capabilities"]["protocol"] == 1
    assert (report["gone"]["code"], report["gone"]["status"], report["gone"]["reason"]) == (
        "session-gone",
        410,
        "closed",
    )
    assert report["goneStream"]["code"] == "session-gone"


async def test_problems_are_typed(server: OwnServer, scenario: Scenario) -> None:
    report = await scenario("problems", server.url)
    assert report.pop("same")
    assert {name: (problem["code"], problem["status"]) for name, problem in report.items()} == {
        "box": ("bad-box", 422),
        "option": ("bad-request", 400),
        "image": ("unsupported-image", 415),
        "session": ("session-not-found", 404),
        "stream": ("session-not-found", 404),
        "target": ("target-not-found", 404),
        "snapshot": ("bad-snapshot", 422),
        "elsewhere": ("attached-elsewhere", 409),
        "source": ("unsupported-source", 0),
        "away": ("connection-lost", 0),
        "takenOver": ("attached-elsewhere", 409),
        "aborted": ("aborted", 0),
    }
    assert report["box"]["type"].endswith("#bad-box")
    assert report["box"]["title"]
    assert report["box"]["detail"]


async def test_creating_waits_for_a_place_as_long_as_it_is_told(own_server: Serve, scenario: Scenario) -> None:
    server = own_server(max_sessions_per_lane=1)
    report = await scenario("full", server.url)
    assert (report["refused"]["code"], report["refused"]["status"]) == ("at-capacity", 503)
    assert report["refused"]["retryAfter"] > 0
    assert report["aborted"]["code"] == "aborted"
    assert (report["waited"], report["got"]) == (True, 0)


async def test_a_loop_that_is_left_ends_the_attachment(server: OwnServer, scenario: Scenario) -> None:
    """By break and by an exception: the next call and the next stream need not wait or take over."""
    report = await scenario("left", server.url)
    assert report["statuses"][::2] == ["closed"] * 3
    assert (report["count"], report["attached"]) == (3, False)


async def test_what_is_given_wrongly_is_told_before_anything_is_sent(server: OwnServer, scenario: Scenario) -> None:
    wrong = {
        "ws://127.0.0.1:8000": "http: or https:",
        "wss://tracking.test": "http: or https:",
        "127.0.0.1:8000": "http: or https:",
        "localhost:8000": "http: or https:",
        "/tracking": "http: or https:",
        "http://": "http: or https:",
        "http://tracking.test:99999": "http: or https:",
        "http://me:secret@tracking.test": "must not contain a user and password",
        "http://tracking.test/?x=1": "without a query",
        "http://tracking.test/#top": "without a query",
    }
    right = {
        "http://tracking.test/": "http://tracking.test",
        "HTTPS://tracking.test:8443/a/prefix//": "https://tracking.test:8443/a/prefix",
        "http://[::1]:8000": "http://[::1]:8000",
        "": "http://127.0.0.1:8000",
    }
    report = await scenario("arguments", server.url, urls=list(wrong), right=list(right))
    for url, hint in wrong.items():
        assert (report["urls"][url]["code"], report["urls"][url]["status"]) == ("bad-request", 0)
        assert hint in report["urls"][url]["detail"]
        assert "secret" not in report["urls"][url]["detail"]
    assert report["right"] == list(right.values())
    assert "from-a-file" not in report["key"]["detail"]
    assert report["boxesIn"]["detail"] == 'boxesIn is one of "sent" and "source", not "screen"'
    assert "npm install @msgpack/msgpack" in report["codec"]["detail"]
    for refused in report["boxes"]:
        assert (refused["code"], refused["status"]) == ("bad-request", 0)
        assert "a box is four numbers, [x, y, w, h], not" in refused["detail"]


async def test_a_stream_goes_on_when_its_service_is_back(
    own_server: Serve, clip: Clip, scenario: Scenario, tmp_path: Path
) -> None:
    """404 of a replica and of a proxy, 502, 503, refused connections: no result is lost or changed."""
    rollout = Rollout(own_server, tmp_path)
    async with rollout.cable:
        happening: list[asyncio.Task[None]] = []

        def heard(line: dict[str, Any]) -> None:
            if line.get("results") == 10 and not happening:
                happening.append(asyncio.create_task(rollout.happen()))

        report = await scenario("stream", rollout.cable.url, heard, stream={"mode": "lossless", "fps": 40})
        await happening[0]
        undisturbed = await scenario("stream", rollout.first.url, stream={"mode": "lossless"})
    assert [r["targets"] for r in report["results"]] == [r["targets"] for r in undisturbed["results"]]
    assert [resumed["lostAfter"] for resumed in report["resumed"]] == [None] * len(report["resumed"])
    assert report["resumed"]


async def test_a_session_that_stays_away_is_given_up(own_server: Serve, scenario: Scenario, tmp_path: Path) -> None:
    rollout = Rollout(own_server, tmp_path)
    async with rollout.cable:

        def heard(line: dict[str, Any]) -> None:
            if line.get("results") == 10:
                rollout.cable.lead_to(rollout.second.port)

        stream = {"mode": "lossless", "fps": 40, "reconnectForMs": 500}
        with pytest.raises(AssertionError, match="session-not-found"):
            await scenario("stream", rollout.cable.url, heard, stream=stream)


async def test_a_key_or_a_ticket_is_needed_and_a_ticket_admits_once(own_server: Serve, scenario: Scenario) -> None:
    server = own_server(api_keys=KEY)
    async with Cable(server.port) as cable:

        def heard(line: dict[str, Any]) -> None:
            if "cut" in line:
                cable.cut()

        report = await scenario("tickets", cable.url, heard, key=KEY)
    assert report["stranger"]["code"] == "unauthenticated"
    assert report["seqs"] == [1, 2]
    assert report["handed"] >= 2
    assert report["keyed"] == 3
    assert report["renewed"] == [2, 4], "a ticket that the service forgot is replaced where the client has the key"
    assert report["twice"]["code"] == "unauthenticated"
    assert KEY not in server.log
