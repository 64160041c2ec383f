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
        told = await scenario("stream", server.url, stream={"mode": "lossless", "codec": codec})
    ours = await through_python(server.url, clip, [clip.box])
    said = in_process(clip, [clip.box])
    assert len(told["results"]) == len(ours) == len(said)
    for theirs, result, one in zip(told["results"], ours, said, strict=True):
        target = theirs["targets"][0]
        assert tuple(target["box"]) == result.target.box == one[0].box
        assert target["status"] == result.target.status
        assert target["scale"] == result.target.scale
        assert target["psr"] == result.target.psr
        assert (theirs["seq"], theirs["size"], theirs["dropped"]) == (result.seq, list(result.size), 0)
        assert theirs["region"] == (list(result.region) if result.region else None)
    assert told["statuses"] == ["open", "closed"]
    stats = told["stats"]
    assert stats["sent"] == stats["answered"] == len(said)
    assert stats["bytesSent"] == sum(map(len, clip.frames[1:]))
    assert 0 < stats["latencyP50Ms"] <= stats["latencyP95Ms"]
    assert stats["rate"] > 0
    assert (stats["inFlight"], stats["refused"], stats["reconnects"]) == (0, 0, 0)


async def test_both_subprotocols_say_the_same(server: OwnServer, scenario: Scenario) -> None:
    """Response maps included: bytes in both."""
    told = [
        await scenario("stream", server.url, stream={"mode": "lossless", "codec": codec}, options={"maps": True})
        for codec in ("json", "msgpack")
    ]
    assert without_timing(told[0]["results"]) == without_timing(told[1]["results"])
    assert all(result["timing"] for each in told for result in each["results"])
    assert "fused" in told[0]["results"][0]["targets"][0]["maps"]


@pytest.mark.parametrize("codec", ["json", "msgpack"])
async def test_lossless_keeps_to_its_credit(server: OwnServer, clip: Clip, scenario: Scenario, codec: str) -> None:
    """Sixty frames at once: each waits for its turn, none is refused, none is lost."""
    told = await scenario("flood", server.url, stream={"mode": "lossless", "codec": codec})
    assert told["sent"] == told["seqs"] == list(range(1, len(clip.frames)))
    assert told["stats"]["refused"] == told["stats"]["skipped"] == 0


async def test_latest_skips_what_finds_no_room(server: OwnServer, clip: Clip, scenario: Scenario) -> None:
    told = await scenario("flood", server.url, stream={"mode": "latest"})
    stats = told["stats"]
    assert stats["skipped"] > 0
    assert stats["sent"] + stats["skipped"] == len(clip.frames) - 1
    assert stats["sent"] == stats["answered"] + stats["dropped"]
    assert told["seqs"][-1] == told["most"]


async def test_a_reader_that_rests_is_not_flooded(server: OwnServer, scenario: Scenario) -> None:
    told = await scenario("unread", server.url, count=100)
    assert told["resting"]["canSend"] is False
    assert 64 <= told["resting"]["handed"] < 80
    assert told["seqs"] == list(range(1, 101))


async def test_lossless_through_cuts(server: OwnServer, clip: Clip, scenario: Scenario) -> None:
    """Every frame is tracked exactly once and in order, whatever happens to the connection."""
    cuts = 0
    with watch(server):
        async with Cable(server.port) as cable:

            def heard(line: dict[str, Any]) -> None:
                nonlocal cuts
                if line.get("results") in (10, 30, 40):
                    cuts += 1
                    cable.cut()

            told = await scenario("stream", cable.url, heard, stream={"mode": "lossless", "fps": 40})
    assert cuts == 3
    assert told["stats"]["reconnects"] >= 2
    assert "resuming" in told["statuses"]
    said = in_process(clip, [clip.box])
    assert [r["targets"][0]["box"] for r in told["results"]] == [list(one[0].box) for one in said]
    assert all(a["seq"] < b["seq"] for a, b in pairwise(told["results"]))


async def test_latest_through_cuts(server: OwnServer, clip: Clip, scenario: Scenario) -> None:
    async with Cable(server.port) as cable:

        def heard(line: dict[str, Any]) -> None:
            if line.get("results") in (10, 20):
                cable.cut()

        told = await scenario("stream", cable.url, heard, stream={"mode": "latest", "fps": 40, "codec": "msgpack"})
    assert told["stats"]["reconnects"] >= 1
    assert told["results"][-1]["seq"] == told["seq"]
    assert len(told["results"]) > 20


async def test_takes_over_its_own_dead_connection(server: OwnServer, clip: Clip, scenario: Scenario) -> None:
    """A connection that carries nothing any more and says nothing."""
    async with Cable(server.port) as cable:

        def heard(line: dict[str, Any]) -> None:
            if line.get("results") == 10:
                cable.go_dead()

        stream = {"mode": "lossless", "fps": 30, "stallMs": 1500}
        told = await scenario("stream", cable.url, heard, stream=stream)
    said = in_process(clip, [clip.box])
    assert [r["targets"][0]["box"] for r in told["results"]] == [list(one[0].box) for one in said]
    assert told["stats"]["reconnects"] >= 1


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


async def test_goes_on_through_a_restart(own_server: Serve, clip: Clip, scenario: Scenario, tmp_path: Path) -> None:
    """Sessions outlive the process: it is told, every frame is answered, box for box."""
    server = own_server(state_dir=tmp_path / "state")
    restart = Restart(server, signal.SIGTERM)
    told = await scenario("stream", server.url, restart.heard, stream={"mode": "lossless", "fps": 40})
    await restart.done()
    said = in_process(clip, [clip.box])
    assert [r["targets"][0]["box"] for r in told["results"]] == [list(one[0].box) for one in said]
    assert [resumed["lostAfter"] for resumed in told["resumed"]] == [None]
    assert told["resumed"][0]["downMs"] > 0
    order = [status for status in told["statuses"] if status != "connecting"]
    assert order[:3] == ["open", "draining", "resuming"]
    assert order[-2:] == ["open", "closed"]


async def test_goes_on_after_a_breakdown(own_server: Serve, clip: Clip, scenario: Scenario, tmp_path: Path) -> None:
    """kill -9: every frame is answered, and what is forgotten is told."""
    server = own_server(state_dir=tmp_path / "state", checkpoint_every_frames=5)
    restart = Restart(server, signal.SIGKILL)
    told = await scenario("stream", server.url, restart.heard, stream={"mode": "lossless", "fps": 40})
    await restart.done()
    assert len(told["results"]) == len(clip.frames) - 1
    (resumed,) = told["resumed"]
    assert resumed["lostAfter"] in (None, resumed["seq"])


async def test_told_that_the_server_went_away(own_server: Serve, scenario: Scenario) -> None:
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
async def test_controls_and_refusals_in_a_stream(server: OwnServer, clip: Clip, scenario: Scenario, codec: str) -> None:
    told = await scenario("controls", server.url, codec=codec)
    assert told["added"] == [0, 1]
    assert told["refused"]["code"] == "target-not-found"
    assert told["waited"]
    assert told["corrected"] == pytest.approx(clip.box)
    result = told["result"]
    assert result["ts"] == "mark"
    assert result["targets"][0]["reliable"] is None
    assert result["targets"][1]["reliable"] is not None
    assert told["removed"] == [1]
    assert [0, 1] in told["told"]
    assert told["told"][-1] == [1, 2]
    assert [(p["code"], p["seq"]) for p in told["problems"]] == [("unsupported-image", 2), ("frame-undecodable", 3)]
    assert told["after"] == 4
    assert (told["ended"]["code"], told["done"], told["status"]) == ("stream-ended", True, "closed")


async def test_every_call(server: OwnServer, clip: Clip, scenario: Scenario) -> None:
    with watch(server):
        told = await scenario("calls", server.url)
    assert told["info"]["label"] == "from node"
    assert told["info"]["targets"][0]["box"] == list(clip.box)
    assert (told["result"]["seq"], told["result"]["ts"]) == (1, 17.5)
    assert told["added"]["target"]["id"] == 1
    assert told["corrected"]["target"]["box"] == list(clip.box)
    assert [target["id"] for target in told["again"]["targets"]] == [0]
    assert told["id"] in told["listed"]
    assert [each["seq"] for each in told["trajectory"]] == [0, 1]
    assert [each["seq"] for each in told["later"]] == [1]
    assert told["texts"]["csv"].startswith("seq,ts,target,x,y,w,h")
    assert len(told["texts"]["otb"].splitlines()) == 2
    assert len(told["texts"]["mot"].splitlines()) == 2
    assert told["restored"]["seq"] == 1
    assert told["restored"]["id"] != told["id"]
    assert told["one"] == told["other"]
    assert set(told["ticket"]) == {"ticket", "expires_at"}
    assert told["capabilities"]["protocol"] == 1
    assert (told["gone"]["code"], told["gone"]["status"], told["gone"]["reason"]) == ("session-gone", 410, "closed")
    assert told["goneStream"]["code"] == "session-gone"


async def test_problems_are_typed(server: OwnServer, scenario: Scenario) -> None:
    told = await scenario("problems", server.url)
    assert told.pop("same")
    assert {name: (problem["code"], problem["status"]) for name, problem in told.items()} == {
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
    assert told["box"]["type"].endswith("#bad-box")
    assert told["box"]["title"]
    assert told["box"]["detail"]


async def test_creating_waits_for_a_place_as_long_as_it_is_told(own_server: Serve, scenario: Scenario) -> None:
    server = own_server(max_sessions_per_lane=1)
    told = await scenario("full", server.url)
    assert (told["refused"]["code"], told["refused"]["status"]) == ("at-capacity", 503)
    assert told["refused"]["retryAfter"] > 0
    assert told["aborted"]["code"] == "aborted"
    assert (told["waited"], told["got"]) == (True, 0)


async def test_a_loop_that_is_left_ends_the_attachment(server: OwnServer, scenario: Scenario) -> None:
    """By break and by an exception: the next call and the next stream need not wait or take over."""
    told = await scenario("left", server.url)
    assert told["statuses"][::2] == ["closed"] * 3
    assert (told["count"], told["attached"]) == (3, False)


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
    told = await scenario("arguments", server.url, urls=list(wrong), right=list(right))
    for url, hint in wrong.items():
        assert (told["urls"][url]["code"], told["urls"][url]["status"]) == ("bad-request", 0)
        assert hint in told["urls"][url]["detail"]
        assert "secret" not in told["urls"][url]["detail"]
    assert told["right"] == list(right.values())
    assert "from-a-file" not in told["key"]["detail"]
    for refused in told["boxes"]:
        assert (refused["code"], refused["status"]) == ("bad-request", 0)
        assert "a box is four numbers, [x, y, w, h], not" in refused["detail"]


async def test_goes_on_when_its_service_is_back(
    own_server: Serve, clip: Clip, scenario: Scenario, tmp_path: Path
) -> None:
    """404 of a replica and of a proxy, 502, 503, refused connections: no result is lost or changed."""
    rollout = Rollout(own_server, tmp_path)
    async with rollout.cable:
        happening: list[asyncio.Task[None]] = []

        def heard(line: dict[str, Any]) -> None:
            if line.get("results") == 10 and not happening:
                happening.append(asyncio.create_task(rollout.happen()))

        told = await scenario("stream", rollout.cable.url, heard, stream={"mode": "lossless", "fps": 40})
        await happening[0]
        undisturbed = await scenario("stream", rollout.first.url, stream={"mode": "lossless"})
    assert [r["targets"] for r in told["results"]] == [r["targets"] for r in undisturbed["results"]]
    assert [resumed["lostAfter"] for resumed in told["resumed"]] == [None] * len(told["resumed"])
    assert told["resumed"]


async def test_a_session_that_stays_away_is_given_up(own_server: Serve, scenario: Scenario, tmp_path: Path) -> None:
    rollout = Rollout(own_server, tmp_path)
    async with rollout.cable:

        def heard(line: dict[str, Any]) -> None:
            if line.get("results") == 10:
                rollout.cable.lead_to(rollout.second.port)

        stream = {"mode": "lossless", "fps": 40, "reconnectForMs": 500}
        with pytest.raises(AssertionError, match="session-not-found"):
            await scenario("stream", rollout.cable.url, heard, stream=stream)


async def test_keys_and_tickets(own_server: Serve, scenario: Scenario) -> None:
    server = own_server(api_keys=KEY)
    async with Cable(server.port) as cable:

        def heard(line: dict[str, Any]) -> None:
            if "cut" in line:
                cable.cut()

        told = await scenario("tickets", cable.url, heard, key=KEY)
    assert told["stranger"]["code"] == "unauthenticated"
    assert told["seqs"] == [1, 2]
    assert told["handed"] >= 2
    assert told["keyed"] == 3
    assert told["twice"]["code"] == "unauthenticated"
    assert KEY not in server.log
