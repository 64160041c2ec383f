"""Places, dead lanes, hung lanes, the end of the process."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time

import httpx2

from service.load.clips import Clip
from service.load.usage import server_processes

from .conftest import Serve, Wire


def lanes_of(wire: Wire) -> list[int]:
    """Process ids of the lanes."""
    return [pid for role, pid in server_processes(wire.server.pid).items() if role.startswith("lane")]


async def until_ready(wire: Wire, lanes: int) -> None:
    """Wait for so many lanes."""
    give_up = time.monotonic() + 20
    while time.monotonic() < give_up:
        response = await wire.http.get("/readyz")
        if response.json()["lanes_ready"] == lanes:
            return
        await asyncio.sleep(0.02)
    raise AssertionError("the lane was not replaced")


async def test_a_hundred_at_once_on_ten_places(serve: Serve, clip: Clip) -> None:
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
    await wire.create(clip.frames[0], clip.box, idle_timeout_s=0.01)
    await asyncio.sleep(0.05)
    await wire.create(clip.frames[0], clip.box)
    assert (await wire.post(clip.frames[0], clip.box)).status_code == 503
    assert (await wire.http.get(f"/v1/sessions/{living['id']}")).status_code == 200


async def test_a_killed_lane_is_noticed_replaced_and_alone(serve: Serve, clip: Clip) -> None:
    wire = serve(lanes=2, max_sessions_per_lane=4)
    first, second = [await wire.create(clip.frames[0], clip.box) for _ in range(2)]
    before = lanes_of(wire)
    async with (
        wire.stream(first["id"], mode="lossless") as one,
        wire.stream(second["id"], mode="lossless") as two,
    ):
        os.kill(before[0], signal.SIGKILL)
        ends = {asyncio.create_task(stream.closed()): stream for stream in (one, two)}
        done, _ = await asyncio.wait(ends, timeout=5, return_when=asyncio.FIRST_COMPLETED)
        assert [task.result() for task in done] == [4410]
        (lost,) = done
        dead, alive = (first, second) if ends[lost] is one else (second, first)
        for task in ends.keys() - done:
            task.cancel()
        response = await wire.http.get(f"/v1/sessions/{dead['id']}")
        assert (response.status_code, response.json()["code"]) == (410, "session-gone")
        assert response.json()["reason"] == "lost"
    assert (await wire.track(alive["id"], clip.frames[1])).status_code == 200
    await until_ready(wire, 2)
    assert len(set(lanes_of(wire)) - set(before)) == 1
    for _ in range(7):
        await wire.create(clip.frames[0], clip.box)
    assert 'mfcmt_lane_restarts_total{cause="died"} 1.0' in (await wire.http.get("/metrics")).text
    assert "Traceback" not in wire.server.log
    assert len([line for line in wire.server.log.splitlines() if json.loads(line)["level"] == "error"]) == 1


async def test_a_lane_is_killed_in_the_middle_of_frames(serve: Serve, clip: Clip) -> None:
    wire = serve(lanes=1)
    for _ in range(3):
        session = await wire.create(clip.frames[0], clip.box)
        async with wire.stream(session["id"], mode="lossless") as stream:
            for frame in clip.frames[1:5]:
                await stream.frame(frame)
            os.kill(lanes_of(wire)[0], signal.SIGKILL)
            assert await stream.closed() == 4410
        await until_ready(wire, 1)
    assert "Traceback" not in wire.server.log


async def test_a_hung_lane_is_replaced_after_the_deadline(serve: Serve, clip: Clip) -> None:
    wire = serve(lanes=1, operation_deadline_s=0.5)
    session, waiting = [await wire.create(clip.frames[0], clip.box) for _ in range(2)]
    hung = lanes_of(wire)[0]
    os.kill(hung, signal.SIGSTOP)
    answers = await asyncio.gather(wire.track(session["id"], clip.frames[1]), wire.track(waiting["id"], clip.frames[1]))
    told = sorted((a.status_code, a.json()["code"]) for a in answers)
    assert told == [(410, "session-gone"), (504, "deadline-exceeded")]
    await until_ready(wire, 1)
    assert lanes_of(wire) != [hung]
    assert (await wire.http.get(f"/v1/sessions/{session['id']}")).json()["reason"] == "lost"
    await wire.create(clip.frames[0], clip.box)


async def test_lanes_end_with_a_killed_front(serve: Serve, clip: Clip) -> None:
    wire = serve(lanes=2)
    await wire.create(clip.frames[0], clip.box)
    processes = server_processes(wire.server.pid)
    os.kill(processes["lane 0"], signal.SIGSTOP)  # as if in a computation that does not end
    os.kill(wire.server.pid, signal.SIGKILL)
    give_up = time.monotonic() + 10
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
    give_up = time.monotonic() + 15
    while wire.server.exit_code is None and time.monotonic() < give_up:
        await asyncio.sleep(0.05)
    return wire.server.exit_code
