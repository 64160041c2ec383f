"""Two tenants do anything in any order, against the real application and real trackers: nothing leaks.

Whatever a tenant is told, nothing in it belongs to the other; whatever it does to the other's sessions is
answered, byte for byte, as for sessions that never were, and changes nothing that the other can see.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, consumes, invariant, multiple, rule
from starlette.testclient import TestClient, WebSocketDenialResponse, WebSocketTestSession

from mfcmt_core.images import FrameLimits
from service.app import create_app
from service.lanes.framing import decode_call, encode_reply
from service.lanes.interface import Buffers, LaneLost
from service.lanes.limits import LaneLimits
from service.lanes.operations import LaneOperations
from service.protocol.problems import ProblemError
from service.settings import Settings

from .test_registry import Lanes

KEYS = ("key-of-the-first-tenant", "key-of-the-other-tenant")
PLACES = 12
NEVER = "AAAAAAAAAAAAAAAAAAAAAAAA"
SNAPSHOT = "application/vnd.mfcmt.snapshot"
BOX = [30, 20, 24, 24]
LIMITS = LaneLimits(
    FrameLimits(max_bytes=1 << 20, max_pixels=1 << 20, max_side=4096, max_scans=16), max_targets=4, region_lag=1
)
JPEG = cv2.imencode(
    ".jpg", cv2.resize(np.random.default_rng(7).integers(0, 255, (18, 24, 3), dtype=np.uint8), (96, 72))
)[1].tobytes()


class OwnLanes(Lanes):
    """One real lane's store, without the process around it."""

    def __init__(self) -> None:
        super().__init__(PLACES)
        self.store = LaneOperations(LIMITS)

    async def call(self, key: str, request: Buffers) -> bytes:
        if key not in self.keys:
            raise LaneLost("absent")
        try:
            return encode_reply(None, self.store.handle(*decode_call(memoryview(b"".join(request)))))
        except ProblemError as refused:
            return encode_reply(refused.code, [refused.detail, refused.members])

    def release(self, key: str) -> None:
        super().release(key)
        self.store.handle("drop", key, {}, b"")


# What may be asked of a session, and with what.
CALLS: dict[str, Callable[[TestClient, str, dict[str, str]], Any]] = {
    "look": lambda http, path, key: http.get(path, headers=key),
    "past": lambda http, path, key: http.get(f"{path}/trajectory?format=csv", headers=key),
    "track": lambda http, path, key: http.post(f"{path}/frames", content=JPEG, headers=key),
    "add": lambda http, path, key: http.post(f"{path}/targets", json={"box": BOX}, headers=key),
    "correct": lambda http, path, key: http.put(f"{path}/targets/0", json={"box": BOX}, headers=key),
    "remove": lambda http, path, key: http.delete(f"{path}/targets/0", headers=key),
    "end": lambda http, path, key: http.delete(path, headers=key),
    "snapshot": lambda http, path, key: http.get(f"{path}/snapshot", headers=key),
    "ticket": lambda http, path, key: http.post(f"{path}/ticket", json={}, headers=key),
}
tenants = st.sampled_from((0, 1))


class Tenants(RuleBasedStateMachine):
    """``owner`` and ``alive`` are the model; ``private`` is what each tenant alone may see."""

    ids = Bundle("ids")
    snapshots = Bundle("snapshots")
    tickets = Bundle("tickets")

    def __init__(self) -> None:
        super().__init__()
        chosen = {"api_keys": ",".join(KEYS), "signing_keys": "the-secret-that-signs"}
        app = create_app(Settings(**chosen, lanes=1, max_sessions_per_lane=PLACES), lanes=OwnLanes())
        self.stack = ExitStack()
        self.http = self.stack.enter_context(TestClient(app))
        self.owner: dict[str, int] = {}
        self.alive: set[str] = set()
        self.private: tuple[set[str], set[str]] = (set(), set())
        self.streams: dict[str, WebSocketTestSession] = {}
        self.count = itertools.count()

    def teardown(self) -> None:
        for sid in list(self.streams):
            self.hang_up(sid)
        self.stack.close()

    def checked(self, tenant: int, response: Any) -> Any:
        """The answer, once it is seen to hold nothing of the other's and nothing of ours."""
        text = response.content.decode("latin-1") + str(response.headers)
        assert response.status_code < 500 or response.json()["code"] == "at-capacity", text
        self.check(tenant, text)
        return response

    def check(self, tenant: int, text: str) -> None:
        for secret in self.private[1 - tenant]:
            assert secret not in text
        for ours in ("Traceback", "/service/", "mfcmt_core", "site-packages", *KEYS):
            assert ours not in text

    def made(self, tenant: int, response: Any, label: str) -> Any:
        if response.status_code != 201:
            # Half of the places are each tenant's own, whatever the other does.
            assert response.json()["code"] == "over-quota"
            assert sum(self.owner[sid] == tenant for sid in self.alive) == PLACES // 2
            return multiple()
        sid: str = response.json()["id"]
        assert sid not in self.owner
        self.owner[sid] = tenant
        self.alive.add(sid)
        self.private[tenant].update((sid, label))
        return sid

    def hang_up(self, sid: str) -> None:
        self.streams.pop(sid).__exit__(None, None, None)

    @rule(target=ids, tenant=tenants, preset=st.sampled_from(("default", "paper")))
    def create(self, tenant: int, preset: str) -> Any:
        label = f"label-{next(self.count)}-of-{tenant}"
        form = {"box": json.dumps(BOX), "options": json.dumps({"label": label, "preset": preset})}
        headers = {"X-API-Key": KEYS[tenant], "Idempotency-Key": label[:7]}  # the other uses the same ones
        response = self.http.post("/v1/sessions", files={"frame": JPEG}, data=form, headers=headers)
        if response.status_code == 400:  # used by oneself, with another body
            return multiple()
        return self.made(tenant, self.checked(tenant, response), label)

    @rule(target=tickets, tenant=tenants, sid=ids, name=st.sampled_from(sorted(CALLS)))
    def ask(self, tenant: int, sid: str, name: str) -> Any:
        key = {"X-API-Key": KEYS[tenant]}
        response = self.checked(tenant, CALLS[name](self.http, f"/v1/sessions/{sid}", key))
        if self.owner[sid] != tenant:
            never = CALLS[name](self.http, f"/v1/sessions/{NEVER}", key)
            assert (response.status_code, response.content) == (never.status_code, never.content)
            assert response.status_code == 404
            return multiple()
        if sid not in self.alive:
            assert response.status_code == (204 if name == "end" else 410)
            return multiple()
        if name == "end":
            assert response.status_code == 204
            self.alive.remove(sid)
            if sid in self.streams:
                self.hang_up(sid)
        if name == "ticket":
            self.private[tenant].add(response.json()["ticket"])
            return (sid, response.json()["ticket"])
        return multiple()

    @rule(target=snapshots, sid=ids)
    def take(self, sid: str) -> Any:
        tenant = self.owner[sid]
        response = self.checked(
            tenant, self.http.get(f"/v1/sessions/{sid}/snapshot", headers={"X-API-Key": KEYS[tenant]})
        )
        return multiple() if sid not in self.alive else (tenant, response.content)

    @rule(target=ids, tenant=tenants, snapshot=snapshots)
    def restore(self, tenant: int, snapshot: tuple[int, bytes]) -> Any:
        owner, data = snapshot
        headers = {"X-API-Key": KEYS[tenant], "Content-Type": SNAPSHOT}
        response = self.checked(tenant, self.http.post("/v1/sessions", content=data, headers=headers))
        if owner != tenant:
            assert (response.status_code, response.json()["code"]) == (422, "bad-snapshot")
            return multiple()
        return self.made(tenant, response, response.json().get("label") or "label-")

    @rule(tenant=tenants)
    def list_all(self, tenant: int) -> None:
        response = self.checked(tenant, self.http.get("/v1/sessions?limit=100", headers={"X-API-Key": KEYS[tenant]}))
        mine = {sid for sid in self.alive if self.owner[sid] == tenant}
        assert {session["id"] for session in response.json()["sessions"]} == mine

    @rule(tenant=tenants, sid=ids, takeover=st.booleans())
    def attach(self, tenant: int, sid: str, takeover: bool) -> None:
        """With a key of one's own."""
        headers = {"X-API-Key": KEYS[tenant]}
        refusal = self.open_stream(tenant, sid, headers, None, takeover)
        if self.owner[sid] != tenant:
            assert refusal == "session-not-found"
        elif sid not in self.alive:
            assert refusal == "session-gone"
        else:
            assert refusal in (None, "attached-elsewhere")

    @rule(ticket=consumes(tickets), sid=ids)
    def attach_by_ticket(self, ticket: tuple[str, str], sid: str) -> None:
        """Whoever holds it, to its session and no other, and once."""
        own, secret = ticket
        protocols = [f"mfcmt.ticket.{secret}", "mfcmt.v1.json"]
        refusal = self.open_stream(self.owner[own], sid, {}, protocols, True)
        assert refusal is None if sid == own and sid in self.alive else refusal in ("unauthenticated", "session-gone")
        assert self.open_stream(self.owner[own], own, {}, protocols, True) == "unauthenticated"

    def open_stream(
        self, tenant: int, sid: str, headers: dict[str, str], protocols: list[str] | None, takeover: bool
    ) -> str | None:
        """None and the stream stands, or the code of the refusal."""
        url = f"/v1/sessions/{sid}/stream?mode=lossless&takeover={str(takeover).lower()}"
        opened = self.http.websocket_connect(url, subprotocols=protocols, headers=headers)
        try:
            socket = opened.__enter__()
        except WebSocketDenialResponse as denied:
            code: str = self.checked(tenant, denied).json()["code"]
            return code
        if sid in self.streams:
            self.hang_up(sid)
        self.streams[sid] = socket
        ready = json.loads(socket.receive_text())
        assert ready["session"]["id"] == sid
        self.check(tenant, json.dumps(ready))
        self.private[tenant].add(ready["attachment"])
        return None

    @rule()
    def strangers(self) -> None:
        """Without a key, or with one that is nearly right, everything is closed."""
        for headers in ({}, {"X-API-Key": KEYS[0][:-1]}, {"X-API-Key": KEYS[0] + "s"}):
            for sid in [*list(self.owner)[:2], NEVER]:
                for call in CALLS.values():
                    assert call(self.http, f"/v1/sessions/{sid}", headers).status_code == 401

    @rule()
    def watch(self) -> None:
        """The metrics and the probes name nobody."""
        text = self.http.get("/metrics").text + self.http.get("/readyz").text + self.http.get("/livez").text
        for secret in self.private[0] | self.private[1]:
            assert secret not in text

    @invariant()
    def streams_go_on(self) -> None:
        """Nobody but its owner ends a stream or speaks in it."""
        for sid, socket in self.streams.items():
            socket.send_bytes(JPEG)
            while (message := json.loads(socket.receive_text()))["type"] == "targets":
                pass
            assert message["type"] == "result"
            self.check(self.owner[sid], json.dumps(message))


Tenants.TestCase.settings = settings(
    max_examples=30,
    stateful_step_count=30,
    suppress_health_check=list(HealthCheck),
    phases=(Phase.explicit, Phase.reuse, Phase.generate),  # to make a failure shorter takes minutes
)
TestTenants = pytest.mark.filterwarnings("ignore::DeprecationWarning")(Tenants.TestCase)
