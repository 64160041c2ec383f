"""What holds for every route, and for the work beside them."""

from __future__ import annotations

import asyncio
import inspect
from typing import Any

import httpx2
import pytest
from structlog.testing import capture_logs

from service import app as application
from service.app import create_app
from service.lanes.interface import LaneStatus
from service.protocol.problems import NO_LANE
from service.protocol.requests import Options
from service.settings import Settings

from .routes import dependencies, routes
from .test_registry import Lanes


def test_no_route_and_no_dependency_runs_in_a_thread() -> None:
    """Sessions, keys and rates are touched on the event loop alone."""
    calls = routes(create_app(Settings()))
    assert {"/v1/sessions/{session_id}", "/v1/sessions/{session_id}/frames", "/readyz", "/"} <= {
        call.path for call in calls
    }
    seen = 0
    for call in calls:
        assert inspect.iscoroutinefunction(call.endpoint), call.path
        for one in dependencies(call.dependant):
            assert inspect.iscoroutinefunction(one.call), (call.path, one.call)
            seen += 1
    assert seen > 20


class SomeLanes(Lanes):
    """Lanes of which some are ready and some fail."""

    def __init__(self, ready: int, failing: int, starting: int) -> None:
        super().__init__(4)
        states = [(True, False)] * ready + [(False, True)] * failing + [(False, False)] * starting
        self.states = [LaneStatus(number, *state, 0, {}) for number, state in enumerate(states)]

    def status(self) -> list[LaneStatus]:
        return self.states


@pytest.mark.parametrize(
    ("ready", "failing", "starting", "status", "detail"),
    [
        (2, 0, 0, 200, "ok"),
        (1, 1, 0, 200, "ok"),
        (1, 0, 1, 200, "ok"),
        (0, 1, 1, 503, "lanes die again and again"),
        (0, 0, 2, 503, NO_LANE),
    ],
)
async def test_the_service_is_ready_as_long_as_one_lane_is(
    ready: int, failing: int, starting: int, status: int, detail: str
) -> None:
    transport = httpx2.ASGITransport(create_app(Settings(), lanes=SomeLanes(ready, failing, starting)))
    async with httpx2.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
        answer = await client.get("/readyz")
    body = answer.json()
    assert (answer.status_code, body.get("detail", body["status"])) == (status, detail)
    assert (body["lanes_ready"], body["lanes"]) == (ready, ready + failing + starting)


@pytest.mark.parametrize(
    ("format", "accept", "status", "kind"),
    [
        ("csv", "text/csv", 200, "text/csv"),
        ("csv", "text/*;q=0.5", 200, "text/csv"),
        ("csv", "application/json", 200, "text/csv"),
        ("csv", "text/plain", 406, "application/problem+json"),
        ("mot", "text/plain", 200, "text/plain"),
        ("otb", "application/msgpack", 200, "text/plain"),
        ("otb", "image/png", 406, "application/problem+json"),
        ("json", "application/msgpack", 200, "application/msgpack"),
        ("json", "text/csv", 406, "application/problem+json"),
    ],
)
async def test_a_trajectory_can_be_asked_for_by_its_own_media_type(
    format: str, accept: str, status: int, kind: str
) -> None:
    app = create_app(Settings(), lanes=Lanes(1))
    options = Options(idle_timeout_s=300.0)
    session = await app.state.service.registry.create("anyone", b"frame", [[1, 2, 3, 4]], options, None)
    transport = httpx2.ASGITransport(app)
    async with httpx2.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
        path = f"/v1/sessions/{session.id}/trajectory?target=0&format={format}"
        answer = await client.get(path, headers={"Accept": accept})
    assert (answer.status_code, answer.headers["content-type"].partition(";")[0]) == (status, kind)


async def test_work_in_the_background_that_fails_is_logged_and_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(application, "AGAIN_S", 0.001)
    monkeypatch.setattr("service.sessions.registry.SWEEP_EVERY_S", 0.001)
    monkeypatch.setattr("service.service.KEYS_EVERY_S", 0.001)
    app = create_app(Settings(), lanes=Lanes(1))
    service: Any = app.state.service
    swept, refreshed = asyncio.Event(), asyncio.Event()
    monkeypatch.setattr(service.registry, "sweep", _fails_once(swept))
    monkeypatch.setattr(service.authenticator.__class__, "refresh", _fails_once(refreshed))
    with capture_logs() as lines:
        async with app.router.lifespan_context(app):
            await asyncio.wait_for(asyncio.gather(swept.wait(), refreshed.wait()), 30)
    faults = [line for line in lines if line["event"] == "background task failed and is started again"]
    assert len(faults) == 2
    assert {line["log_level"] for line in faults} == {"error"}


def _fails_once(again: asyncio.Event) -> Any:
    calls = 0

    def fails_once(*_: object) -> bool:
        nonlocal calls
        calls += 1
        if calls == 1:
            raise ValueError("a fault")
        again.set()
        return False

    return fails_once
