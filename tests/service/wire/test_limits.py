"""Limits of a key and of all keys, on a real server: refused at once, with the time to wait, and nothing queued."""

from __future__ import annotations

import asyncio
import json
import os
from pathlib import Path

import httpx2
import pytest
from websockets.exceptions import InvalidStatus

from service.load.clips import Clip

from .conftest import Serve, Wire

FIRST, SECOND = "key-of-the-first-tenant", "key-of-the-other-tenant"


def two_keys(serve: Serve, **settings: object) -> tuple[Wire, Wire]:
    """Two tenants of one server."""
    first = serve({"X-API-Key": FIRST}, api_keys=f"{FIRST},{SECOND}", **settings)
    return first, Wire(first.server, {"X-API-Key": SECOND})


def refusal_of(response: httpx2.Response) -> tuple[int, str]:
    assert int(response.headers["Retry-After"]) >= 1
    return response.status_code, response.json()["code"]


async def refused(wire: Wire, sid: str) -> tuple[int, str]:
    with pytest.raises(InvalidStatus) as refusal:
        async with wire.stream(sid):
            pass
    response = refusal.value.response
    assert int(response.headers["Retry-After"]) >= 1
    return response.status_code, json.loads(response.body or b"")["code"]


async def test_sessions_of_a_key_have_a_limit_of_their_own(serve: Serve, clip: Clip) -> None:
    """Also when they are made at once; the other key's are its own."""
    first, second = two_keys(serve, max_sessions_per_key=3, max_sessions_per_lane=8)
    made = await asyncio.gather(*(first.post(clip.frames[0], clip.box) for _ in range(8)))
    assert sorted(response.status_code for response in made) == [201] * 3 + [429] * 5
    assert {refusal_of(response) for response in made if response.status_code == 429} == {(429, "over-quota")}
    for _ in range(3):
        await second.create(clip.frames[0], clip.box)
    mine = next(response.json()["id"] for response in made if response.status_code == 201)
    snapshot = (await first.http.get(f"/v1/sessions/{mine}/snapshot")).content
    kind = {"Content-Type": "application/vnd.mfcmt.snapshot"}
    assert refusal_of(await first.http.post("/v1/sessions", content=snapshot, headers=kind)) == (429, "over-quota")
    assert (await first.http.delete(f"/v1/sessions/{mine}")).status_code == 204
    await first.create(clip.frames[0], clip.box)


async def test_streams_of_a_key_and_of_all_have_limits(serve: Serve, clip: Clip) -> None:
    first, second = two_keys(serve, max_streams_per_key=1, max_streams=2)
    mine = [(await first.create(clip.frames[0], clip.box))["id"] for _ in range(2)]
    theirs = [(await second.create(clip.frames[0], clip.box))["id"] for _ in range(2)]
    async with first.stream(mine[0]):
        assert await refused(first, mine[1]) == (429, "over-quota")
        async with first.stream(mine[0], takeover="true"):  # not one more
            pass
    async with second.stream(theirs[0]) as stream, first.stream(mine[1], headers={"Origin": first.server.url}):
        async with first.stream(mine[0], headers={"Origin": first.server.url}) as browser:
            assert await browser.refused() == "over-quota"
            assert await browser.closed() == 4429
        await stream.frame(clip.frames[1])
        await stream.hear("result")


async def test_streams_of_all_keys_have_a_limit_together(serve: Serve, clip: Clip) -> None:
    first, second = two_keys(serve, max_streams=1)
    mine, theirs = (await first.create(clip.frames[0], clip.box))["id"], (await second.create(clip.frames[0], clip.box))
    async with first.stream(mine):
        assert await refused(second, theirs["id"]) == (503, "at-capacity")


async def test_frames_and_bytes_of_a_key_have_a_rate_of_their_own(serve: Serve, clip: Clip) -> None:
    """In a stream and over HTTP; what is refused changes nothing, and the other key does not feel it."""
    size = len(clip.frames[1])
    first, second = two_keys(
        serve, max_frames_per_s_per_key=6, max_frame_bytes_per_s_per_key=3.5 * size, credit_frames=8
    )
    mine, theirs = (await first.create(clip.frames[0], clip.box))["id"], (await second.create(clip.frames[0], clip.box))
    async with first.stream(mine, mode="lossless") as stream:
        codes, answered = [], 0
        for _ in range(8):  # all at once, so that a busy machine does not spread them over seconds
            await stream.frame(clip.frames[1])
        for _ in range(8):
            message = await stream.hear()
            if message["type"] == "result":
                answered += 1
            else:
                codes.append(message["problem"]["code"])
                assert message["problem"]["retry_after_s"] > 0
        assert codes
        assert set(codes) == {"rate-limited"}
        assert answered <= 5
    responses = [await first.track(mine, clip.frames[1]) for _ in range(8)]
    assert (429, "rate-limited") in {refusal_of(response) for response in responses if response.status_code != 200}
    assert (await second.track(theirs["id"], clip.frames[1])).status_code == 200
    assert (await first.http.get(f"/v1/sessions/{mine}")).json()["seq"] >= answered


async def test_frames_of_all_keys_have_a_rate_together(serve: Serve, clip: Clip) -> None:
    """Many refusals in a row end the stream."""
    wire = serve(max_frames_per_s=2, max_refused_messages=5)
    sid = (await wire.create(clip.frames[0], clip.box))["id"]
    async with wire.stream(sid) as stream:
        codes = []
        for _ in range(4):
            await stream.frame(clip.frames[1])
            message = await stream.hear()
            codes.append(message["problem"]["code"] if message["type"] == "error" else "")
        assert "at-capacity" in codes
        for _ in range(40):
            await stream.frame(clip.frames[1])
        assert await stream.closed() == 4429


@pytest.mark.parametrize("message", [{"type": "meta", "seq": 1}, {"type": "nonsense"}])
async def test_messages_without_a_frame_count_too(serve: Serve, clip: Clip, message: dict[str, object]) -> None:
    wire = serve(max_messages_per_s=20)
    sid = (await wire.create(clip.frames[0], clip.box))["id"]
    async with wire.stream(sid) as stream:
        for _ in range(100):
            await stream.say(**message)
        assert await stream.closed() == 4429


async def test_revoked_keys_lose_their_streams(serve: Serve, clip: Clip, tmp_path: Path) -> None:
    """Two keys of one name are one tenant; a file that cannot be read changes nothing."""
    file = tmp_path / "keys"
    file.write_text(f"# tenants\nacme {FIRST}\nacme {SECOND}\nthe-key-without-a-name\n")
    old = serve({"X-API-Key": FIRST}, api_keys_file=file)
    new = Wire(old.server, {"X-API-Key": SECOND})
    sessions = [(await old.create(clip.frames[0], clip.box))["id"] for _ in range(3)]
    unused = (await old.http.post(f"/v1/sessions/{sessions[2]}/ticket")).json()["ticket"]
    used = (await old.http.post(f"/v1/sessions/{sessions[2]}/ticket")).json()["ticket"]
    bare = Wire(old.server)
    async with (
        old.stream(sessions[0]) as revoked,
        new.stream(sessions[1]) as kept,
        bare.stream(sessions[2], protocols=[f"mfcmt.ticket.{used}", "mfcmt.v1.json"]) as by_ticket,
    ):
        file.write_text("short\n")
        await _logged(old, "the keys stay as they were")
        assert (await old.http.get("/v1/sessions")).status_code == 200
        replacement = tmp_path / "new"
        replacement.write_text(f"acme {SECOND}\n")
        os.replace(replacement, file)
        assert await revoked.closed() == 4401
        assert await by_ticket.closed() == 4401
        await kept.frame(clip.frames[1])
        await kept.hear("result")
        assert (await old.http.get("/v1/sessions")).status_code == 401
        with pytest.raises(InvalidStatus):
            async with bare.stream(sessions[2], protocols=[f"mfcmt.ticket.{unused}"]):
                pass
    async with new.stream(sessions[0]):  # the tenant's still
        pass
    for secret in (FIRST, SECOND, used, unused):
        assert secret not in old.server.log


async def _logged(wire: Wire, text: str) -> None:
    async with asyncio.timeout(30):
        while text not in wire.server.log:
            await asyncio.sleep(0.05)
