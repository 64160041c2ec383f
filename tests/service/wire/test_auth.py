"""Keys, tickets, origins, tenants."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Iterator

import httpx2
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus
from websockets.typing import Origin

from service.load.clips import Clip
from service.load.own import OwnServer

from .conftest import Serve, Stream, Wire, problem

KEY, OTHER, ADMIN = "key-of-the-first-tenant", "key-of-the-other-tenant", "key-of-the-operator"


async def refusal(wire: Wire, sid: str, **how: object) -> tuple[int, str]:
    with pytest.raises(InvalidStatus) as refused:
        async with wire.stream(sid, **how):  # type: ignore[arg-type]
            pass
    response = refused.value.response
    return response.status_code, json.loads(response.body or b"")["code"]


@pytest.fixture(scope="module")
def guarded_server() -> Iterator[OwnServer]:
    """A server that wants keys and knows one foreign origin."""
    with OwnServer(
        lanes=1, api_keys=f"{KEY}, {OTHER}", admin_key=ADMIN, allowed_origins="https://app.example"
    ) as server:
        yield server


@pytest.fixture
async def guarded(guarded_server: OwnServer) -> AsyncIterator[Wire]:
    async with Wire(guarded_server, {"Authorization": f"Bearer {KEY}"}) as wire:
        yield wire


async def test_calls_need_a_key_and_metrics_the_key_of_the_admin(guarded: Wire, clip: Clip) -> None:
    base = guarded.server.url
    async with httpx2.AsyncClient(base_url=base) as bare:
        for headers in ({}, {"X-API-Key": "wrong"}, {"Authorization": "Bearer"}, {"Authorization": f"Basic {KEY}"}):
            for call in (bare.get("/v1/sessions", headers=headers), bare.get("/v1/capabilities", headers=headers)):
                response = await call
                assert (response.status_code, response.json()["code"]) == (401, "unauthenticated")
                assert response.headers["WWW-Authenticate"] == "Bearer"
        assert (await bare.get("/v1/sessions", headers={"X-API-Key": KEY})).status_code == 200
        assert (await bare.get("/v1/sessions", auth=("anybody", KEY))).status_code == 200
        assert (await bare.get("/v1/sessions", auth=(KEY, "wrong"))).status_code == 401
        assert (await bare.get("/livez")).status_code == 200
        assert (await bare.get("/metrics")).status_code == 401
        assert (await bare.get("/metrics", headers={"Authorization": f"Bearer {KEY}"})).status_code == 401
        assert (await bare.get("/metrics", headers={"Authorization": f"Bearer {ADMIN}"})).status_code == 200
    session = await guarded.create(clip.frames[0], clip.box)
    async with guarded.stream(session["id"]):
        pass
    guarded.headers = {}
    assert await refusal(guarded, session["id"]) == (401, "unauthenticated")
    async with guarded.stream(session["id"], headers={"X-API-Key": KEY}):
        pass
    for secret in (KEY, OTHER, ADMIN):
        assert secret not in guarded.server.log


async def test_another_keys_session_is_as_one_that_does_not_exist(guarded: Wire, clip: Clip) -> None:
    session = await guarded.create(clip.frames[0], clip.box)
    sid, path = session["id"], f"/v1/sessions/{session['id']}"
    snapshot = (await guarded.http.get(f"{path}/snapshot")).content
    box = {"box": list(clip.box)}
    async with httpx2.AsyncClient(base_url=guarded.server.url, headers={"X-API-Key": OTHER}) as other:
        never = (await other.get("/v1/sessions/AAAAAAAAAAAAAAAAAAAAAAAA")).json()
        image = {"Content-Type": "image/jpeg"}
        for response in (
            await other.get(path),
            await other.delete(path),
            await other.post(f"{path}/frames", content=clip.frames[1], headers=image),
            await other.post(f"{path}/targets", json=box),
            await other.put(f"{path}/targets/0", json=box),
            await other.delete(f"{path}/targets/0"),
            await other.get(f"{path}/trajectory"),
            await other.get(f"{path}/snapshot"),
            await other.post(f"{path}/ticket"),
        ):
            assert response.json() == never
            assert response.status_code == 404
        assert (await other.get("/v1/sessions")).json()["sessions"] == []
        kind = {"Content-Type": "application/vnd.mfcmt.snapshot"}
        stolen = await other.post("/v1/sessions", content=snapshot, headers=kind)
        assert (stolen.status_code, stolen.json()["code"]) == (422, "bad-snapshot")
        key = {"Idempotency-Key": "same"}
        mine = await guarded.post(clip.frames[0], clip.box, headers=key)
        theirs = await other.post(
            "/v1/sessions", files={"frame": clip.frames[0]}, data={"box": "20,20,40,40"}, headers=key
        )
        assert mine.json()["id"] != theirs.json()["id"]
        await guarded.http.delete(path)
        assert (await other.get(path)).json() == never
        assert (await other.delete(path)).status_code == 404
    guarded.headers = {"X-API-Key": OTHER}
    assert await refusal(guarded, mine.json()["id"], takeover="true") == (404, "session-not-found")
    assert await refusal(guarded, sid) == (404, "session-not-found")


async def test_tickets_admit_once_and_to_their_session_alone(guarded: Wire, clip: Clip) -> None:
    sessions = [(await guarded.create(clip.frames[0], clip.box))["id"] for _ in range(2)]

    async def ticket(sid: str, **body: object) -> str:
        response = await guarded.http.post(f"/v1/sessions/{sid}/ticket", json=body)
        assert response.status_code == 201, response.text
        ticket: str = response.json()["ticket"]
        return ticket

    def offer(ticket: str) -> list[str]:
        return [f"mfcmt.ticket.{ticket}", "mfcmt.v1.msgpack"]

    first, strayed, late = await ticket(sessions[0]), await ticket(sessions[0]), await ticket(sessions[0], ttl_s=0.2)
    key, guarded.headers = guarded.headers, {}
    async with guarded.stream(sessions[0], protocols=offer(first)) as stream:
        assert stream.socket.subprotocol == "mfcmt.v1.msgpack"
        guarded.headers = key
        again = await ticket(sessions[0])
        guarded.headers = {}
        async with guarded.stream(sessions[0], protocols=offer(again), takeover="true"):
            assert await stream.closed() == 4409
    assert await refusal(guarded, sessions[0], protocols=offer(first)) == (401, "unauthenticated")
    assert await refusal(guarded, sessions[1], protocols=offer(strayed)) == (401, "unauthenticated")
    assert await refusal(guarded, sessions[0], protocols=offer(strayed)) == (401, "unauthenticated")
    await asyncio.sleep(0.25)
    assert await refusal(guarded, sessions[0], protocols=offer(late)) == (401, "unauthenticated")
    too_long = await guarded.http.post(f"/v1/sessions/{sessions[0]}/ticket", json={"ttl_s": 1e6})
    assert (too_long.status_code, too_long.json()["code"]) == (400, "bad-request")
    assert first not in guarded.server.log


async def test_browsers_without_a_key_or_from_elsewhere_are_refused(guarded: Wire, clip: Clip) -> None:
    sid = (await guarded.create(clip.frames[0], clip.box))["id"]
    evil, friend = {"Origin": "https://evil.example"}, {"Origin": "https://app.example"}
    async with guarded.stream(sid, headers=evil) as stream:
        assert await stream.refused() == "origin-refused"
        assert await stream.closed() == 4403
    async with guarded.stream(sid, headers=friend) as stream:
        await stream.hear("ready")
    guarded.headers = {}
    async with guarded.stream(sid, headers=friend) as stream:
        assert await stream.refused() == "unauthenticated"
        assert await stream.closed() == 4401
    response = await guarded.http.get("/v1/sessions", headers=evil)
    assert (response.status_code, response.json()["code"]) == (403, "origin-refused")
    assert "access-control-allow-origin" not in response.headers
    response = await guarded.http.get("/v1/sessions", headers=friend)
    assert response.headers["access-control-allow-origin"] == "https://app.example"
    assert "Location" in response.headers["access-control-expose-headers"]
    asked = {"Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "authorization"}
    preflight = await guarded.http.options("/v1/sessions", headers=friend | asked)
    assert preflight.status_code == 204
    assert preflight.headers["access-control-allow-headers"] == "authorization"
    assert (await guarded.http.options("/v1/sessions", headers=evil | asked)).status_code == 403


async def test_calls_above_the_rate_are_refused_with_a_time_to_wait(serve: Serve) -> None:
    wire = serve(max_requests_per_s=5)
    answers = [await wire.http.get("/v1/sessions") for _ in range(10)]
    refused = [a for a in answers if a.status_code == 429]
    assert refused
    assert {a.json()["code"] for a in refused} == {"rate-limited"}
    assert all(int(a.headers["Retry-After"]) >= 1 for a in refused)


async def test_no_secret_is_ever_logged(serve: Serve, clip: Clip) -> None:
    """Whatever is asked with whichever credential, wherever it was put, even where every detail is logged."""
    signing = "the-secret-that-signs-snapshots"
    settings = {"api_keys": f"{KEY},{OTHER}", "admin_key": ADMIN, "signing_keys": signing, "log_level": "debug"}
    wire = serve({"X-API-Key": KEY}, **settings)
    sid = (await wire.create(clip.frames[0], clip.box))["id"]
    ticket = (await wire.http.post(f"/v1/sessions/{sid}/ticket")).json()["ticket"]
    snapshot = (await wire.http.get(f"/v1/sessions/{sid}/snapshot")).content
    async with httpx2.AsyncClient(base_url=wire.server.url) as bare:
        for secret in (KEY, OTHER, ADMIN, f"almost-{KEY}", ticket):
            for headers in ({"X-API-Key": secret}, {"Authorization": f"Bearer {secret}"}, {"Cookie": f"key={secret}"}):
                await bare.get("/v1/sessions", headers=headers)
                await bare.get("/metrics", headers=headers)
            await bare.get("/v1/sessions", params={"key": secret, "ticket": secret, "api_key": secret})
            await bare.post("/v1/sessions", json={"key": secret, secret: 1}, headers={"X-API-Key": KEY})
            await bare.get("/v1/sessions", headers={"X-API-Key": KEY, "X-Request-ID": "mine"})
    wire.headers = {}
    async with wire.stream(
        sid, protocols=[f"mfcmt.ticket.{ticket}", "mfcmt.v1.json"], key=KEY, ticket=ticket
    ) as stream:
        attachment = stream.ready["attachment"]
        await stream.say(type="meta", ts=KEY, region=[KEY])
        await stream.refused()
    await refusal(wire, sid, protocols=[f"mfcmt.ticket.{ticket}"])
    log = wire.server.log
    assert "unauthenticated" in log
    for secret in (KEY, OTHER, ADMIN, ticket, attachment, signing, snapshot[20:40].hex()):
        assert secret not in log


async def test_a_page_of_a_name_that_was_pointed_here_reaches_nothing(serve: Serve, clip: Clip) -> None:
    """DNS rebinding: the browser holds the page and the service for the same origin."""
    wire = serve()
    sid = (await wire.create(clip.frames[0], clip.box))["id"]
    host = f"evil.example:{wire.server.port}"
    evil = {"Host": host, "Origin": f"http://{host}"}
    async with httpx2.AsyncClient(base_url=wire.server.url, headers=evil) as page:
        path = f"/v1/sessions/{sid}"
        paths = ("/v1/sessions", path, f"{path}/snapshot", "/", "/docs", "/livez", "/readyz", "/metrics", "/nowhere")
        refused = [await page.get(path) for path in paths] + [await page.delete(path)]
        refused.append(await page.options(path, headers={"Access-Control-Request-Method": "PUT"}))
        for response in refused:
            assert problem(response) == (421, "host-refused")
            assert "access-control-allow-origin" not in response.headers
    stream_url = f"ws://{host}/v1/sessions/{sid}/stream"
    async with connect(stream_url, host="127.0.0.1", port=wire.server.port, origin=Origin(f"http://{host}")) as socket:
        stream = Stream(socket)
        assert await stream.refused() == "host-refused"
        assert await stream.closed() == 4403
    with pytest.raises(InvalidStatus) as denied:
        async with connect(stream_url, host="127.0.0.1", port=wire.server.port):
            pass
    assert denied.value.response.status_code == 421
    async with wire.stream(sid) as stream:  # still there, and nothing is attached
        assert stream.ready["session"]["seq"] == 0
    for name in ("localhost", "127.0.0.1", "[::1]"):
        async with httpx2.AsyncClient(base_url=wire.server.url, headers={"Host": f"{name}:{wire.server.port}"}) as own:
            assert (await own.get(f"/v1/sessions/{sid}")).status_code == 200
