"""Places, dead lanes, hung lanes, the end of the process."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import httpx2

from service.client import Result
from service.client.types import read_answer
from service.load.clips import Box, Clip
from service.load.usage import server_processes
from tests.service.live.test_main_job import assert_same, in_process

from .conftest import Serve, Wire

# The start of a fork server takes a second of processor time, and the machine may have other work.
PATIENCE_S = 120


def lanes_of(wire: Wire) -> list[int]:
    """Process ids of the lanes."""
    return [pid for role, pid in server_processes(wire.server.pid).items() if role.startswith("lane")]


async def until_ready(wire: Wire, lanes: int) -> None:
    """Wait for so many lanes."""
    give_up = time.monotonic() + PATIENCE_S
    while time.monotonic() < give_up:
        response = await wire.http.get("/readyz")
        if response.json()["lanes_ready"] == lanes:
            return
        await asyncio.sleep(0.02)
    raise AssertionError("the lane was not replaced")


async def until(happened: Callable[[], bool]) -> None:
    """Wait for something."""
    give_up = time.monotonic() + PATIENCE_S
    while not happened():
        assert time.monotonic() < give_up
        await asyncio.sleep(0.02)


async def test_a_hundred_at_once_fill_ten_places_and_no_more(serve: Serve, clip: Clip) -> None:
    wire = serve(lanes=2, max_sessions_per_lane=5)
    limits = httpx2.Limits(max_connections=100)
    async with httpx2.AsyncClient(base_url=wire.server.url, timeout=60, limits=limits) as http:
        body = {"files": {"frame": clip.frames[0]}, "data": {"box": ",".join(map(str, clip.box))}}
        answers = await asyncio.gather(*(http.post("/v1/sessions", **body) for _ in range(100)))
    made = [a.json()["id"] for a in answers if a.status_code == 201]
    refused = [a for a in answers if a.status_code == 503]
    assert (len(made), len(refused)) == (10, 90)
    assert {a.json()["code"] for a in refused} == {"at-capacity"}
    assert all(int(a.headers["Retry-After"]) >= 1 for a in refused)
    metrics = (await wire.http.get("/metrics")).text
    assert 'mfcmt_lane_sessions{lane="0"} 5.0' in metrics
    assert 'mfcmt_lane_sessions{lane="1"} 5.0' in metrics
    for sid in made:
        assert (await wire.track(sid, clip.frames[1])).status_code == 200
    assert (await wire.http.delete(f"/v1/sessions/{made[0]}")).status_code == 204
    await wire.create(clip.frames[0], clip.box)


async def test_the_expired_make_room_and_the_living_stay(serve: Serve, clip: Clip) -> None:
    wire = serve(max_sessions_per_lane=2)
    living = await wire.create(clip.frames[0], clip.box)
    await wire.create(clip.frames[0], clip.box, idle_timeout_s=1)
    await asyncio.sleep(1.1)
    await wire.create(clip.frames[0], clip.box)
    assert (await wire.post(clip.frames[0], clip.box)).status_code == 503
    assert (await wire.http.get(f"/v1/sessions/{living['id']}")).status_code == 200


async def test_a_killed_lane_is_replaced_and_nothing_is_lost(serve: Serve, clip: Clip) -> None:
    """The streams of both lanes go on, one of them in a fresh lane, each with the boxes of an undisturbed run."""
    wire = serve(lanes=2, max_sessions_per_lane=4, checkpoint_every_frames=4)
    first, second = [await wire.create(clip.frames[0], clip.box) for _ in range(2)]
    said = in_process(clip, [clip.box])
    before = lanes_of(wire)
    async with (
        wire.stream(first["id"], mode="lossless") as one,
        wire.stream(second["id"], mode="lossless") as two,
    ):
        for index, frame in enumerate(clip.frames[1:16], 1):
            if index == 11:
                os.kill(before[0], signal.SIGKILL)
            for stream in (one, two):
                await stream.frame(frame)
                assert_same(read_answer(Result, await stream.hear("result")).target, said[index - 1][0])
    await until_ready(wire, 2)
    assert len(set(lanes_of(wire)) - set(before)) == 1
    for _ in range(6):
        await wire.create(clip.frames[0], clip.box)
    metrics = (await wire.http.get("/metrics")).text
    assert 'mfcmt_lane_restarts_total{cause="died"} 1.0' in metrics
    assert recoveries(metrics) == 1
    assert 'mfcmt_checkpoints_total{reason="frames"}' in metrics
    assert "Traceback" not in wire.server.log
    assert len([line for line in wire.server.log.splitlines() if json.loads(line)["level"] == "error"]) == 1


class Busy:
    """A lossless stream that always has as many frames unanswered as it may; ``results`` come in order."""

    def __init__(self, wire: Wire, session: dict[str, Any], clip: Clip) -> None:
        self.wire, self.session, self.clip = wire, session, clip
        self.results: list[Result] = []

    async def run(self, done: asyncio.Event) -> None:
        """Send until ``done``, and hear what was sent."""
        async with self.wire.stream(self.session["id"], mode="lossless") as stream:
            sent = 0
            while not done.is_set() or len(self.results) < sent:
                while not done.is_set() and sent - len(self.results) < stream.ready["credit"]:
                    sent += 1
                    await stream.frame(self.clip.frame(sent))
                self.results.append(read_answer(Result, await stream.hear("result")))
                assert self.results[-1].seq == len(self.results)


def around(clip: Clip) -> list[Box]:
    """Boxes at the target and beside it: a frame with many keeps a lane busy for longer than its way to it."""
    x, y, w, h = clip.box
    return [(x + across, y + down, w, h) for across in (-9, -3, 3, 9) for down in (-6, 6)]


def value(metrics: str, name: str) -> float:
    """Of one series."""
    return next(float(line.split()[1]) for line in metrics.splitlines() if line.startswith(f"{name} "))


def in_lanes(metrics: str) -> list[float]:
    """Sessions of both lanes."""
    return [value(metrics, f'mfcmt_lane_sessions{{lane="{lane}"}}') for lane in (0, 1)]


async def test_a_session_moves_from_a_full_lane_to_an_idle_one(serve: Serve, clip: Clip) -> None:
    """Two busy streams that began in one lane end in two: no result is missing, and every box is the library's."""
    wire = serve(lanes=2)
    boxes = around(clip)
    sessions = [await wire.create(clip.frames[0], *boxes) for _ in range(3)]
    placed = in_lanes((await wire.http.get("/metrics")).text)
    together = [sessions[0 if placed == [2, 1] else 1], sessions[2]]
    streams = [Busy(wire, session, clip) for session in together]
    done = asyncio.Event()
    metrics = ""
    async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as group:
        for stream in streams:
            group.create_task(stream.run(done))
        while value(metrics := (await wire.http.get("/metrics")).text, "mfcmt_session_moves_total") < 1:
            await asyncio.sleep(0.2)
        heard = [len(stream.results) for stream in streams]
        while any(len(stream.results) < before + 20 for stream, before in zip(streams, heard, strict=True)):
            await asyncio.sleep(0.05)
        done.set()
    longest = max(len(stream.results) for stream in streams)
    said = in_process(replace(clip, frames=[clip.frame(index) for index in range(longest + 1)]), boxes)
    for stream in streams:
        for result, targets in zip(stream.results, said, strict=False):
            for target, expected in zip(result.targets, targets, strict=True):
                assert_same(target, expected)
    metrics = (await wire.http.get("/metrics")).text
    assert in_lanes(metrics) == placed[::-1]
    assert value(metrics, "mfcmt_session_moves_total") == 1
    assert value(metrics, 'mfcmt_checkpoints_total{reason="move"}') == 1
    assert recoveries(metrics) == 0
    moved = [json.loads(line) for line in wire.server.log.splitlines() if '"session moved"' in line]
    assert [record["session"] in {session["id"] for session in together} for record in moved] == [True]
    assert "Traceback" not in wire.server.log


async def test_keys_share_a_lane_whatever_the_number_of_their_sessions(serve: Serve, clip: Clip) -> None:
    """One key streams in five sessions, the other in one, all of them as fast as they can: half and half."""
    keys = ("key-of-the-first-tenant", "key-of-the-other-tenant")
    many = serve({"X-API-Key": keys[0]}, lanes=1, api_keys=",".join(keys))
    one = Wire(many.server, {"X-API-Key": keys[1]})
    streams = [Busy(wire, await wire.create(clip.frames[0], *around(clip)), clip) for wire in [many] * 5 + [one]]
    done = asyncio.Event()
    async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as group:
        for stream in streams:
            group.create_task(stream.run(done))
        while not all(len(stream.results) >= 5 for stream in streams):
            await asyncio.sleep(0.01)
        before = [len(stream.results) for stream in streams]
        while len(streams[-1].results) < before[-1] + 100:
            await asyncio.sleep(0.01)
        served = [len(stream.results) - had for stream, had in zip(streams, before, strict=True)]
        done.set()
    # One in six if every session had the same; a client that is short of processor time is not always in the queue.
    assert 0.3 < served[-1] / sum(served) < 0.6, served
    assert min(served[:5]) > max(served[:5]) / 2, served


async def test_a_small_frame_waits_for_one_large_one_at_most(serve: Serve, clip: Clip) -> None:
    """Two sessions send 4K frames as fast as they can; one that is sent behind the other would be waited for too."""
    wire = serve(lanes=1)
    large = replace(clip, frames=clip.frames[:2]).resized((3840, 2160))
    large = replace(large, box=(100, 100, 3600, 1900))  # so large that whole frames are decoded
    streams = [Busy(wire, await wire.create(large.frames[0], large.box), large) for _ in range(2)]
    modest = await wire.create(clip.frames[0], clip.box)
    done = asyncio.Event()
    between = []
    async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as group, wire.stream(modest["id"]) as stream:
        for busy in streams:
            group.create_task(busy.run(done))
        for index in range(1, 20):
            while not all(len(busy.results) >= 2 * index for busy in streams):
                await asyncio.sleep(0.002)
            before = sum(len(busy.results) for busy in streams)
            await stream.frame(clip.frame(index))
            await stream.hear("result")
            between.append(sum(len(busy.results) for busy in streams) - before)
        done.set()
    assert sorted(between)[len(between) // 2] <= 1, between


def recoveries(metrics: str) -> float:
    """Sessions restored, whatever the cause."""
    lines = [line for line in metrics.splitlines() if line.startswith("mfcmt_recoveries_total{")]
    return sum(float(line.split()[1]) for line in lines)


async def test_an_idle_session_is_restored_with_all_its_targets(serve: Serve, clip: Clip) -> None:
    """What was asked for between frames is part of what is restored, also what was refused."""
    wire = serve(lanes=1)
    x, y, w, h = clip.box
    twin, session = [await wire.create(clip.frames[0], clip.box) for _ in range(2)]
    for one in (twin, session):
        path = f"/v1/sessions/{one['id']}/targets"
        await wire.track(one["id"], clip.frames[1])
        assert (await wire.http.post(path, json={"box": [x + 5, y, w, h]})).status_code == 201
        assert (await wire.http.post(path, json={"box": [x, y + 5, w, h]})).status_code == 201
        assert (await wire.http.delete(f"{path}/1")).status_code == 204
        assert (await wire.http.put(f"{path}/7", json={"box": [x, y, w, h]})).status_code == 404
    undisturbed = [(await wire.track(twin["id"], frame)).json()["targets"] for frame in clip.frames[2:6]]
    os.kill(lanes_of(wire)[0], signal.SIGKILL)
    await until(lambda: "session restored" in wire.server.log)
    again = [(await wire.track(session["id"], frame)).json()["targets"] for frame in clip.frames[2:6]]
    assert again == undisturbed


async def test_a_lane_killed_in_the_middle_of_frames_changes_no_box(serve: Serve, clip: Clip) -> None:
    wire = serve(lanes=1, checkpoint_every_frames=3)
    said = in_process(clip, [clip.box])
    for _ in range(3):
        session = await wire.create(clip.frames[0], clip.box)
        async with wire.stream(session["id"], mode="lossless") as stream:
            for frame in clip.frames[1:5]:
                await stream.frame(frame)
            os.kill(lanes_of(wire)[0], signal.SIGKILL)
            for index in range(4):
                assert_same(read_answer(Result, await stream.hear("result")).target, said[index][0])
        await until_ready(wire, 1)
    assert "Traceback" not in wire.server.log


async def test_a_hung_lane_is_replaced_after_the_deadline(serve: Serve, clip: Clip) -> None:
    wire = serve(lanes=1, operation_deadline_s=2)
    sessions = [await wire.create(clip.frames[0], clip.box) for _ in range(2)]
    hung = lanes_of(wire)[0]
    os.kill(hung, signal.SIGSTOP)
    answers = await asyncio.gather(*(wire.track(session["id"], clip.frames[1]) for session in sessions))
    assert [answer.status_code for answer in answers] == [200, 200]
    assert answers[0].json()["targets"] == answers[1].json()["targets"]
    assert lanes_of(wire) != [hung]
    assert 'mfcmt_lane_restarts_total{cause="hung"} 1.0' in (await wire.http.get("/metrics")).text


async def test_lanes_end_with_a_killed_front(serve: Serve, clip: Clip) -> None:
    wire = serve(lanes=2)
    await wire.create(clip.frames[0], clip.box)
    processes = server_processes(wire.server.pid)
    os.kill(processes["lane 0"], signal.SIGSTOP)  # as if in a computation that does not end
    os.kill(wire.server.pid, signal.SIGKILL)
    give_up = time.monotonic() + PATIENCE_S
    while time.monotonic() < give_up and any(_alive(pid) for pid in processes.values()):
        await asyncio.sleep(0.05)
    assert not [role for role, pid in processes.items() if _alive(pid)]


def _alive(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


async def test_the_first_sigterm_drains_and_streams_are_told(serve: Serve, clip: Clip) -> None:
    wire = serve(lanes=1, drain_grace_s=3)
    session = await wire.create(clip.frames[0], clip.box)
    async with wire.stream(session["id"], mode="lossless") as stream:
        os.kill(wire.server.pid, signal.SIGTERM)
        assert (await stream.hear("draining"))["reconnect_in_s"] > 0
        for call, code in (
            (wire.http.get("/readyz"), 503),
            (wire.http.get("/livez"), 200),
            (wire.post(clip.frames[0], clip.box), 503),
        ):
            response = await call
            assert response.status_code == code
            if code == 503:
                assert response.json()["code"] == "draining"
                assert int(response.headers["Retry-After"]) >= 1
        await stream.frame(clip.frames[1])
        assert (await stream.hear("result"))["seq"] == 1
        async with wire.stream(session["id"], headers={"Origin": wire.server.url}, takeover="true") as refused:
            assert await refused.refused() == "draining"
            assert await refused.closed() == 1013
        assert await stream.closed() == 1012
    assert await _exit_code(wire) == 0
    assert "Traceback" not in wire.server.log


async def test_the_second_sigterm_stops_at_once(serve: Serve, clip: Clip) -> None:
    wire = serve(lanes=1, drain_grace_s=60)
    session = await wire.create(clip.frames[0], clip.box)
    async with wire.stream(session["id"]) as stream:
        os.kill(wire.server.pid, signal.SIGTERM)
        await stream.hear("draining")
        os.kill(wire.server.pid, signal.SIGTERM)
        assert await stream.closed() in (1001, 1012)
    assert await _exit_code(wire) == 0


async def _exit_code(wire: Wire) -> int | None:
    give_up = time.monotonic() + PATIENCE_S
    while wire.server.exit_code is None and time.monotonic() < give_up:
        await asyncio.sleep(0.05)
    return wire.server.exit_code
