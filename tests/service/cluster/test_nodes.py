"""Two real nodes that share a real Redis: each client reaches each session, whichever node it asks."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Iterator

import httpx2
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosedError, InvalidStatus

from service.client import Problem
from service.load.clips import Clip
from service.load.own import OwnServer
from tests.service.jsclient.conftest import Scenario

from .nodes import KEY, Run, client, create
from .nodes import node as make_node
from .redis_server import RedisServer

HEADERS = {"X-API-Key": KEY}
SECOND_KEY = "a-second-key-of-all-nodes-0123456"


@pytest.fixture(scope="module")
def pair(redis_server: RedisServer) -> Iterator[tuple[OwnServer, OwnServer]]:
    keys = {"api_keys": f"{KEY},{SECOND_KEY}", "max_sessions_per_key": 3}
    with make_node("a", redis_server, **keys) as first, make_node("b", redis_server, **keys) as second:
        yield first, second


@pytest.fixture
async def session(pair: tuple[OwnServer, OwnServer], clip: Clip) -> AsyncIterator[str]:
    """A session of the first node."""
    sid = await create(pair[0], clip)
    yield sid
    async with client(pair[0]) as there:
        await there.call("DELETE", f"/v1/sessions/{sid}")


@pytest.fixture
async def http(pair: tuple[OwnServer, OwnServer]) -> AsyncIterator[httpx2.AsyncClient]:
    """Bare calls at the second node, which follow no redirect."""
    async with httpx2.AsyncClient(base_url=pair[1].url, headers=HEADERS) as bare:
        yield bare


async def test_a_session_names_its_node_and_points_to_it(pair: tuple[OwnServer, OwnServer], clip: Clip) -> None:
    first, _ = pair
    async with httpx2.AsyncClient(base_url=first.url, headers=HEADERS) as bare:
        form = {"frame": ("frame.jpg", clip.frames[0], "image/jpeg")}
        made = await bare.post("/v1/sessions", files=form, data={"box": ",".join(map(str, clip.box))})
        assert made.status_code == 201
        info = made.json()
        assert info["id"].startswith("a.")
        assert made.headers["Location"] == f"{first.url}/v1/sessions/{info['id']}"
        assert info["stream"]["url"] == f"ws{first.url[4:]}/v1/sessions/{info['id']}/stream"
        assert (await bare.delete(f"/v1/sessions/{info['id']}")).status_code == 204


async def test_small_calls_are_passed_on(session: str, http: httpx2.AsyncClient, clip: Clip) -> None:
    shown = await http.get(f"/v1/sessions/{session}")
    assert (shown.status_code, shown.json()["id"]) == (200, session)
    added = await http.post(f"/v1/sessions/{session}/targets", json={"box": list(clip.box)})
    assert (added.status_code, added.json()["target"]["id"]) == (201, 1)
    assert (await http.delete(f"/v1/sessions/{session}/targets/1")).status_code == 204
    assert (await http.delete(f"/v1/sessions/{session}/targets/7")).json()["code"] == "target-not-found"


async def test_large_calls_are_redirected(
    session: str, http: httpx2.AsyncClient, pair: tuple[OwnServer, OwnServer], clip: Clip
) -> None:
    where = f"/v1/sessions/{session}"
    jpeg = {"Content-Type": "image/jpeg"}
    sent = await http.post(f"{where}/frames?seq=5", content=clip.frames[1], headers=jpeg)
    assert (sent.status_code, sent.json()["code"]) == (307, "elsewhere")
    assert sent.headers["Location"] == sent.json()["url"] == f"{pair[0].url}{where}/frames?seq=5"
    for below in ("trajectory?format=csv", "snapshot"):
        assert (await http.get(f"{where}/{below}")).headers["Location"] == f"{pair[0].url}{where}/{below}"


async def test_nobody_is_told_of_another_key_s_session(session: str, pair: tuple[OwnServer, OwnServer]) -> None:
    async with httpx2.AsyncClient(base_url=pair[1].url, headers={"X-API-Key": SECOND_KEY}) as other:
        assert (await other.get(f"/v1/sessions/{session}")).json()["code"] == "session-not-found"
        assert (await other.get("/v1/sessions/a.never-was")).json()["code"] == "session-not-found"


async def test_a_handshake_is_redirected(session: str, pair: tuple[OwnServer, OwnServer]) -> None:
    first, second = pair
    stream = f"/v1/sessions/{session}/stream?mode=lossless"
    upgrade = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }
    async with httpx2.AsyncClient(base_url=second.url, headers=HEADERS | upgrade) as bare:
        answer = await bare.get(stream)
    assert answer.status_code == 307
    assert answer.headers["Location"] == f"ws{first.url[4:]}{stream}"


async def test_a_browser_is_told_by_a_message(session: str, pair: tuple[OwnServer, OwnServer]) -> None:
    first, second = pair
    stream = f"/v1/sessions/{session}/stream?mode=lossless"
    async with connect(f"ws{second.url[4:]}{stream}", additional_headers=HEADERS | {"Origin": second.url}) as socket:
        problem = json.loads(await socket.recv())["problem"]
        with pytest.raises(ConnectionClosedError):
            await socket.recv()
    assert (problem["code"], problem["url"]) == ("elsewhere", f"ws{first.url[4:]}{stream}")
    assert socket.close_code == 4307


async def test_the_python_client_goes_to_the_node(session: str, pair: tuple[OwnServer, OwnServer], clip: Clip) -> None:
    _, second = pair
    async with client(second) as there:
        known = await there.session(session)
        assert (await known.track(clip.frames[1])).seq == 1
        assert await Run(known, clip.frames[2:10], 0).finish() == list(range(8))
        assert len(await known.trajectory()) == 10
        await known.snapshot()


@pytest.mark.parametrize("codec", ["json", "msgpack"])
async def test_the_javascript_client_goes_to_the_node(
    session: str, pair: tuple[OwnServer, OwnServer], scenario: Scenario, codec: str, clip: Clip
) -> None:
    """With a key, so by a ticket that the other node passes on."""
    first, second = pair
    stream = {"mode": "lossless", "codec": codec, "fps": 100}
    told = await scenario("attached", second.url, session=session, key=KEY, stream=stream)
    assert told["seqs"] == list(range(1, len(clip.frames)))
    assert told["resumed"] == []
    assert told["url"].startswith(f"ws{first.url[4:]}")


async def test_a_ticket_of_one_node_is_spent_once_for_all(session: str, pair: tuple[OwnServer, OwnServer]) -> None:
    first, second = pair
    async with client(second) as there:
        ticket = (await (await there.session(session)).ticket()).ticket
    offered = ["mfcmt.v1.json", f"mfcmt.ticket.{ticket}"]
    where = f"/v1/sessions/{session}/stream"
    async with connect(f"ws{first.url[4:]}{where}", subprotocols=offered) as socket:  # type: ignore[arg-type]
        assert json.loads(await socket.recv())["type"] == "ready"
    for server in pair:
        with pytest.raises(InvalidStatus) as refused:
            await connect(f"ws{server.url[4:]}{where}", subprotocols=offered)  # type: ignore[arg-type]
        assert refused.value.response.status_code == 401


async def test_an_idempotency_key_makes_one_session_of_all_nodes(pair: tuple[OwnServer, OwnServer], clip: Clip) -> None:
    headers = HEADERS | {"Idempotency-Key": "the-same-for-both"}
    made = []
    for server in (*pair, *pair):
        form = {"frame": ("frame.jpg", clip.frames[0], "image/jpeg")}
        async with httpx2.AsyncClient(base_url=server.url, headers=headers, follow_redirects=True) as bare:
            answer = await bare.post("/v1/sessions", files=form, data={"box": ",".join(map(str, clip.box))})
            assert answer.status_code == 201, answer.text
            made.append(answer.json()["id"])
    assert len(set(made)) == 1
    async with client(pair[1]) as there:
        await there.call("DELETE", f"/v1/sessions/{made[0]}")


async def when_there_is_room(server: OwnServer, clip: Clip) -> str:
    """Make a session as soon as the quota allows it; the end of another one is written soon."""
    while True:
        try:
            return await create(server, clip)
        except Problem as refused:
            if refused.code != "over-quota":
                raise
            await asyncio.sleep(0.02)


async def test_a_quota_holds_over_all_nodes(pair: tuple[OwnServer, OwnServer], clip: Clip) -> None:
    first, second = pair
    made = [await when_there_is_room(server, clip) for server in (first, second, first)]
    for server in pair:
        with pytest.raises(Problem) as refused:
            await create(server, clip)
        assert refused.value.code == "over-quota"
    async with client(first) as there:
        for sid in made:
            await there.call("DELETE", f"/v1/sessions/{sid}")
    last = await when_there_is_room(second, clip)
    async with client(first) as there:
        await there.call("DELETE", f"/v1/sessions/{last}")


async def test_an_ended_session_is_remembered_by_all(pair: tuple[OwnServer, OwnServer], clip: Clip) -> None:
    first, second = pair
    sid = await when_there_is_room(first, clip)
    async with client(first) as there, client(second) as other:
        await there.call("DELETE", f"/v1/sessions/{sid}")
        codes = set()
        while "session-gone" not in codes:
            with pytest.raises(Problem) as refused:
                await other.session(sid)
            codes.add(refused.value.code)
