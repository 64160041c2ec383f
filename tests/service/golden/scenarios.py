"""The exchanges that are recorded: each talks to a server and writes what comes back to its tape."""

from __future__ import annotations

import base64
import json
import os
import signal
import time
from collections.abc import Callable
from typing import Any

import msgpack
from websockets.exceptions import InvalidStatus

from service.load.own import OwnServer

from .tape import BOX, JSON, MSGPACK, Tape, frame

PAPER = {"preset": "paper"}
AS_JSON = {"Content-Type": "application/json"}
OTHER = [100.0, 60.0, 24.0, 20.0]
KEY, OTHER_KEY = "golden-key-0123456789", "another-key-0123456789"
# Settings of the servers that the scenarios talk to.
SERVERS: dict[str, dict[str, Any]] = {
    "open": {"lanes": 1, "max_targets_per_session": 3, "max_messages_per_s": 2000, "signing_keys": "s" * 32},
    "keyed": {
        "lanes": 1,
        "api_keys": f"{KEY},{OTHER_KEY}",
        "max_sessions_per_lane": 4,
        "max_sessions_per_key": 2,
        "max_streams_per_key": 1,
        "max_requests_per_s": 1000,
        "allowed_origins": "https://app.example",
        "max_frame_bytes": 65536,
        "credit_frames": 1,
        "max_frame_pixels": 100_000,
    },
}
Scenario = Callable[[Tape], None]


def create(tape: Tape, *boxes: Any, **options: Any) -> str:
    """Make a session from frame 0 by a form; its id."""
    data = {"boxes": json.dumps(list(boxes) or [BOX]), "options": json.dumps(PAPER | options)}
    note = f"form: frame 0, {data['boxes']}, {data['options']}"
    response = tape.call("POST", "/v1/sessions", note=note, files={"frame": frame(0)}, data=data)
    return _named(tape, response.json()["id"])


def _named(tape: Tape, sid: str) -> str:
    return tape.name(sid, "session")


def packed(value: Any) -> dict[str, Any]:
    """A MessagePack body."""
    return {"content": msgpack.packb(value), "headers": {"Content-Type": "application/msgpack"}}


def plain(value: Any) -> dict[str, Any]:
    """A JSON body."""
    return {"content": json.dumps(value), "headers": {"Content-Type": "application/json"}, "note": json.dumps(value)}


def raw(index: int) -> dict[str, Any]:
    """A frame as the body."""
    return {"content": frame(index), "headers": {"Content-Type": "image/jpeg"}, "note": f"frame {index}"}


def sessions(tape: Tape) -> None:
    """Sessions are made in every encoding, read, listed by pages and ended."""
    form = {"box": ",".join(map(str, BOX))}
    response = tape.call("POST", "/v1/sessions", note="form: frame 0, box", files={"frame": frame(0)}, data=form)
    first = _named(tape, response.json()["id"])
    second = create(tape, BOX, OTHER, label='Größe "1"', idle_timeout_s=60, maps=True, on_resize="rescale")
    text = base64.b64encode(frame(0)).decode()
    body = plain({"frame": text, "box": BOX, "options": PAPER}) | {"note": "JSON: frame 0 in base64, box"}
    _named(tape, tape.call("POST", "/v1/sessions", **body).json()["id"])
    body = packed({"frame": frame(0), "boxes": [BOX], "options": PAPER})
    body["headers"] |= {"Accept": "application/msgpack", "Idempotency-Key": "once"}
    made = tape.call("POST", "/v1/sessions", note="MessagePack: frame 0, boxes", **body)
    last = _named(tape, msgpack.unpackb(made.content)["id"])
    tape.call("POST", "/v1/sessions", note="the same again with the same Idempotency-Key", **body)
    after = tape.call("GET", "/v1/sessions?limit=3").json()["next"]
    tape.call("GET", f"/v1/sessions?after={after}&limit=3", shown="/v1/sessions?after=<page>&limit=3")
    tape.call("GET", "/v1/sessions", headers={"Accept": "application/msgpack"})
    tape.call("GET", f"/v1/sessions/{second}")
    tape.call("HEAD", f"/v1/sessions/{first}")
    tape.call("GET", f"/v1/sessions/{second}", headers={"Accept": "application/msgpack, application/json;q=0.5"})
    tape.call("DELETE", f"/v1/sessions/{first}")
    tape.call("DELETE", f"/v1/sessions/{first}")
    tape.call("GET", f"/v1/sessions/{first}")
    tape.call("POST", f"/v1/sessions/{first}/frames", **raw(1))
    tape.call("DELETE", f"/v1/sessions/{last}")
    tape.call("POST", "/v1/sessions", note="the Idempotency-Key of a session that has ended", **body)
    tape.call("GET", "/v1/sessions/AAAAAAAAAAAAAAAAAAAAAAAA")


def frames(tape: Tape) -> None:
    """Frames are tracked over HTTP in every encoding."""
    sid = create(tape)
    tape.call("POST", f"/v1/sessions/{sid}/frames", **raw(1))
    tape.call("POST", f"/v1/sessions/{sid}/frames?seq=5&ts=a%22b%2Cc", **raw(2))
    form = {"seq": "7", "ts": "1.5"}
    tape.call("POST", f"/v1/sessions/{sid}/frames?seq=7&ts=x", note="form: frame 3", files={"frame": frame(3)})
    tape.call("POST", f"/v1/sessions/{sid}/frames", note="form: frame 3, seq, ts", files={"frame": frame(3)}, data=form)
    body = packed({"frame": frame(4), "seq": 9, "ts": 12})
    body["headers"] |= {"Accept": "application/msgpack"}
    tape.call("POST", f"/v1/sessions/{sid}/frames", note="MessagePack: frame 4, seq 9, ts 12", **body)
    text = base64.b64encode(frame(3)).decode()
    body = plain({"frame": text, "ts": "later"}) | {"note": "JSON: frame 3 in base64, ts"}
    tape.call("POST", f"/v1/sessions/{sid}/frames", **body)
    tape.call("GET", f"/v1/sessions/{sid}")
    with_maps = create(tape, maps=True)
    tape.call("POST", f"/v1/sessions/{with_maps}/frames", **raw(1))
    body = raw(2)
    body["headers"] |= {"Accept": "application/msgpack"}
    tape.call("POST", f"/v1/sessions/{with_maps}/frames", **body)
    two = create(tape, BOX, OTHER)
    tape.call("POST", f"/v1/sessions/{two}/frames", **raw(1))


def targets(tape: Tape) -> None:
    """Targets are added, corrected and removed over HTTP, between two frames."""
    sid = create(tape)
    tape.call("POST", f"/v1/sessions/{sid}/frames", **raw(1))
    tape.call("POST", f"/v1/sessions/{sid}/targets", **plain({"box": OTHER}))
    tape.call("POST", f"/v1/sessions/{sid}/frames", **raw(2))
    tape.call("PUT", f"/v1/sessions/{sid}/targets/0", **plain({"box": [50, 40, 30.5, 24]}))
    tape.call("POST", f"/v1/sessions/{sid}/targets", note="MessagePack: box", **packed({"box": OTHER}))
    tape.call("POST", f"/v1/sessions/{sid}/targets", **plain({"box": OTHER}))
    tape.call("DELETE", f"/v1/sessions/{sid}/targets/1")
    tape.call("DELETE", f"/v1/sessions/{sid}/targets/1")
    tape.call("PUT", f"/v1/sessions/{sid}/targets/7", **plain({"box": OTHER}))
    for wrong in ([1, 2, 3], [0, 0, 0.5, 9], [500, 500, 20, 20], "1,2,3,4", None):
        tape.call("POST", f"/v1/sessions/{sid}/targets", **plain({"box": wrong}))
    tape.call("POST", f"/v1/sessions/{sid}/targets", **plain({"box": OTHER, "ref": 1}))
    tape.call("GET", f"/v1/sessions/{sid}")
    tape.call("DELETE", f"/v1/sessions/{sid}/targets/0")
    tape.call("DELETE", f"/v1/sessions/{sid}/targets/2")
    tape.call("POST", f"/v1/sessions/{sid}/frames", **raw(3))


def trajectory(tape: Tape) -> None:
    """The past of a session is read in every format."""
    sid = create(tape, BOX, OTHER)
    for index in (1, 2):
        tape.call("POST", f"/v1/sessions/{sid}/frames?ts=%3D{index}", **raw(index))
    tape.call("PUT", f"/v1/sessions/{sid}/targets/0", **plain({"box": BOX}))
    path = f"/v1/sessions/{sid}/trajectory"
    tape.call("GET", path)
    tape.call("GET", f"{path}?after=1", headers={"Accept": "application/msgpack"})
    tape.call("GET", f"{path}?after=0&target=1")
    tape.call("GET", f"{path}?after=9007199254740991")
    tape.call("GET", f"{path}?format=csv")
    tape.call("GET", f"{path}?format=otb&target=0")
    tape.call("GET", f"{path}?format=mot")
    tape.call("GET", f"{path}?format=otb")
    tape.call("GET", f"{path}?format=xml")
    tape.call("GET", f"{path}?format=csv", headers={"Accept": "image/png"})
    tape.call("HEAD", path)


def snapshots(tape: Tape) -> None:
    """A session goes on from its snapshot under a new id."""
    sid = create(tape, BOX, OTHER, label="kept", idle_timeout_s=77, maps=False)
    tape.call("POST", f"/v1/sessions/{sid}/frames", **raw(1))
    snapshot = tape.call("GET", f"/v1/sessions/{sid}/snapshot").content
    tape.call("GET", f"/v1/sessions/{sid}/snapshot", headers={"Accept": "application/octet-stream"})
    tape.call("GET", f"/v1/sessions/{sid}/snapshot", headers={"Accept": "application/json"})
    kind = {"Content-Type": "application/vnd.mfcmt.snapshot"}
    restored = tape.call("POST", "/v1/sessions", note="the snapshot", content=snapshot, headers=kind)
    again = _named(tape, restored.json()["id"])
    for one in (sid, again):
        tape.call("POST", f"/v1/sessions/{one}/frames", **raw(2))
    tape.call("GET", f"/v1/sessions/{again}/trajectory")
    broken = snapshot[:-1] + bytes([snapshot[-1] ^ 1])
    tape.call("POST", "/v1/sessions", note="the snapshot, a bit turned", content=broken, headers=kind)
    tape.call("POST", "/v1/sessions", note="no snapshot", content=b"MFCMTS", headers=kind)


def service(tape: Tape) -> None:
    """What the service says about itself."""
    tape.call("GET", "/v1/capabilities")
    tape.call("GET", "/v1/capabilities", headers={"Accept": "application/msgpack"})
    tape.call("GET", "/livez")
    tape.call("GET", "/readyz")
    tape.call("HEAD", "/readyz")


def refusals(tape: Tape) -> None:
    """Calls are refused with the right code."""
    sid = create(tape)
    tape.call("GET", "/nothing")
    tape.call("PATCH", f"/v1/sessions/{sid}")
    tape.call("GET", f"/v1/sessions/{sid}", headers={"Accept": "text/html"})
    tape.call("GET", "/v1/sessions?limit=0")
    tape.call("GET", f"/v1/sessions/{sid}", headers={"Host": "evil.example"})
    tape.call("POST", "/v1/sessions", note="nothing")
    tape.call("POST", "/v1/sessions", **plain({"box": BOX}))
    tape.call("POST", "/v1/sessions", content=b"{", headers=AS_JSON, note="{")
    tape.call(
        "POST",
        "/v1/sessions",
        content=b'{"a":1,"a":2}',
        headers={"Content-Type": "application/json"},
        note="a key twice",
    )
    tape.call("POST", "/v1/sessions", content=b"x", headers={"Content-Type": "text/plain"}, note="x")
    text = base64.b64encode(frame(0)).decode()
    for rest in (
        {},
        {"box": BOX, "boxes": [BOX]},
        {"boxes": []},
        {"box": [0, 0, 1]},
        {"box": [0, 0, 1e300, 9]},
        {"box": BOX, "options": {"preset": "best"}},
        {"box": BOX, "options": {"speed": 1}},
        {"box": BOX, "options": {"idle_timeout_s": 0.5}},
        {"box": BOX, "options": {"idle_timeout_s": 1e6}},
        {"box": BOX, "options": {"label": "x" * 201}},
        {"box": BOX, "extra": 1},
        {"boxes": [BOX] * 4},
    ):
        note = f"JSON: frame 0, {json.dumps(rest)[:80]}"
        tape.call("POST", "/v1/sessions", **plain({"frame": text} | rest) | {"note": note})
    garbage = base64.b64encode(b"\xff\xd8\xff nothing").decode()
    tape.call("POST", "/v1/sessions", **plain({"frame": garbage, "box": BOX}) | {"note": "a damaged image"})
    body = {"files": {"frame": frame(0)}, "data": {"box": "1,2,3,4"}}
    tape.call("POST", "/v1/sessions", headers={"Idempotency-Key": "a b"}, note="a bad Idempotency-Key", **body)
    path = f"/v1/sessions/{sid}/frames"
    tape.call("POST", f"{path}?seq=-1", **raw(1))
    tape.call("POST", f"{path}?seq=9007199254740992", **raw(1))
    tape.call("POST", f"{path}?region=1,2,3", **raw(1))
    tape.call("POST", path, content=b"GIF89a", headers={"Content-Type": "image/gif"}, note="GIF")
    tape.call("POST", path, content=frame(1)[:900], headers={"Content-Type": "image/jpeg"}, note="a frame cut off")
    tape.call("POST", path, content=b"", headers={"Content-Type": "image/jpeg"}, note="nothing")
    tape.call(
        "POST", path, content=frame(1), headers={"Content-Type": "application/x-www-form-urlencoded"}, note="curl -d"
    )
    tape.call("POST", f"{path}?seq=9", **raw(1))
    tape.call("POST", f"{path}?seq=9", **raw(2))
    tape.call("POST", path, content=_larger(), headers={"Content-Type": "image/png"}, note="a frame of another size")
    with tape.stream(sid) as talk:
        talk.hear()
        tape.call("POST", path, **raw(2))


def _larger() -> bytes:
    import cv2
    import numpy as np

    return cv2.imencode(".png", np.zeros((100, 100), np.uint8))[1].tobytes()


def _stream(tape: Tape, protocol: str) -> None:
    """Frames, controls and refusals on one stream."""
    sid = create(tape)
    with tape.stream(sid, "mode=lossless", protocol) as talk:
        talk.hear()
        talk.frame(frame(1), "1")
        talk.hear()
        talk.frame(frame(2), "2", seq=4, ts="t")
        talk.hear()
        talk.send(type="add", box=OTHER, ref="r")
        talk.hear()
        talk.send(type="correct", target=1, box=[101, 61, 24, 20])
        talk.hear()
        talk.send(type="remove", target=9, ref=2)
        talk.hear()
        talk.send(type="add", box=[400, 400, 10, 10], ref=2.5)
        talk.hear()
        talk.send(type="remove", target=0, ref="next", on="next")
        talk.send(type="correct", target=5, box=BOX, on="next")
        talk.frame(frame(3), "3", ts=3)
        for _ in range(3):
            talk.hear()
        talk.send(type="add", box=BOX, ref="a", on="next")
        talk.frame(b"GIF89a", "GIF", seq=20)
        for _ in range(2):
            talk.hear()
        talk.frame(frame(4), "4", seq=4)
        talk.hear()
        talk.frame(frame(4)[:900], "4, cut off")
        talk.hear()
        talk.frame(_larger(), "of another size", ts=1.25)
        talk.hear()
        for wrong in (
            {"type": "jump"},
            {"kind": "add"},
            {"type": "add", "ref": "no box"},
            {"type": "add", "box": BOX, "ref": "x" * 65},
            {"type": "add", "box": BOX, "speed": 1, "ref": 7},
            {"type": "remove", "target": -1},
            {"type": "remove", "target": 1, "on": "last"},
        ):
            talk.send(**wrong)
            talk.hear()
        if protocol == MSGPACK:
            talk.send(type="frame", frame="text")
            talk.hear()
            talk.send(type="meta", seq=30)
            talk.hear()
        else:
            talk.send(type="meta", seq=True)
            talk.hear()
            talk.send(type="frame", frame="text")
            talk.hear()
        tape.call("POST", f"/v1/sessions/{sid}/targets", **plain({"box": BOX}))
        talk.hear()
        tape.call("DELETE", f"/v1/sessions/{sid}/targets/1")
        talk.hear()
        talk.frame(frame(4), "4")
        talk.hear()
        tape.call("DELETE", f"/v1/sessions/{sid}")
        talk.closed()
    tape.call("GET", f"/v1/sessions/{sid}/trajectory")


def stream_json(tape: Tape) -> None:
    """Everything that goes over a stream of JSON and bare frames."""
    _stream(tape, JSON)


def stream_msgpack(tape: Tape) -> None:
    """Everything that goes over a stream of MessagePack."""
    _stream(tape, MSGPACK)


def handshakes(tape: Tape) -> None:
    """A stream is attached, taken over, resumed, refused and closed."""
    sid = create(tape, maps=True)
    with tape.stream(sid, "", "") as first:
        first.hear()
        with tape.stream(sid, "takeover=true&mode=latest", MSGPACK) as second:
            name = second.hear()["attachment"]
            first.closed()
            second.frame(frame(1), "1")
            second.hear()
            tape.call("GET", f"/v1/sessions/{sid}")
            with tape.stream(sid, f"resume={name}&mode=lossless", f"mfcmt.v9, {JSON}") as third:
                third.hear()
                second.closed()
                third.frame(frame(2), "2")
                third.hear()
                third.send_raw("{")
                third.closed()
    tape.call("GET", f"/v1/sessions/{sid}/trajectory?after=1")
    for protocol, unreadable in (
        (JSON, "[]"),
        (JSON, "/9j/AAAA"),
        (MSGPACK, "{}"),
        (MSGPACK, frame(0)[:9]),
        (MSGPACK, b"\xc1"),
    ):
        with tape.stream(sid, "", protocol) as talk:
            talk.hear()
            talk.send_raw(unreadable)
            talk.closed()
    with tape.stream(sid, "resume=unknown") as last:
        last.hear()
        for query, origin in (("", {}), ("resume=unknown", {}), ("mode=fast", {}), ("speed=1", {})):
            _refused(tape, sid, query, **origin)
        own = f"http://{tape.address}"
        for query in ("", "mode=fast"):
            with tape.stream(sid, query, Origin=own) as talk:
                talk.hear()
                talk.closed()
    _refused(tape, "unknown", "")
    with tape.stream("unknown", "", Origin=own) as talk:
        talk.hear()
        talk.closed()


def _refused(tape: Tape, sid: str, query: str = "", protocol: str = JSON, **headers: str) -> None:
    """A handshake that is refused by an HTTP answer."""
    try:
        with tape.stream(sid, query, protocol, **headers):
            raise AssertionError("a stream was opened")
    except InvalidStatus as refused:
        tape.answered(refused.response.status_code, list(refused.response.headers.raw_items()), refused.response.body)


def regions(tape: Tape) -> None:
    """Parts of frames are tracked; a part that does not do is refused."""
    import cv2
    import numpy as np

    sid = create(tape)

    def part(index: int, x: int, y: int, w: int, h: int) -> bytes:
        image = cv2.imdecode(np.frombuffer(frame(index), np.uint8), cv2.IMREAD_COLOR)
        return cv2.imencode(".png", image[y : y + h, x : x + w])[1].tobytes()

    with tape.stream(sid, "mode=lossless") as talk:
        region = talk.hear()["session"]["region"]
        for index in (1, 2):
            talk.frame(part(index, *region), f"{index}, cut", region=region)
            region = talk.hear()["region"]
        talk.send(type="add", box=[2, 2, 12, 10], ref="unseen")
        talk.hear()
        talk.frame(part(3, *region), "3, cut", region=[region[0] + 1, *region[1:3], region[3] - 1])
        talk.hear()
        talk.frame(part(3, 0, 0, 8, 8), "3, a corner", region=[0, 0, 8, 8])
        talk.hear()
        talk.frame(part(3, 0, 0, 8, 8), "3, beyond", region=[-1, 0, 8, 8])
        talk.hear()
        talk.frame(frame(3), "3", region=[0, 0, 160, "120"])
        for _ in range(2):  # the refusal of what is said about the frame, and its result without it
            talk.hear()
        talk.frame(frame(3), "3")
        talk.hear()
        talk.send(type="add", box=[2, 2, 12, 10], ref="seen")
        talk.hear()
    x, y, w, h = region
    body = {"content": part(4, x, y, w, h), "headers": {"Content-Type": "image/png"}}
    tape.call("POST", f"/v1/sessions/{sid}/frames?region={x},{y},{w},{h}", note="4, cut for one target", **body)
    tape.call("GET", f"/v1/sessions/{sid}")


def rescale(tape: Tape) -> None:
    """Targets are started anew on a frame of another size."""
    sid = create(tape, on_resize="rescale")
    tape.call("POST", f"/v1/sessions/{sid}/frames", **raw(1))
    body = {"content": _larger(), "headers": {"Content-Type": "image/png"}}
    tape.call("POST", f"/v1/sessions/{sid}/frames", note="another size", **body)


def keys(tape: Tape) -> None:
    """With keys: who may do what, tickets, origins, quotas and limits."""
    mine, other = {"Authorization": f"Bearer {KEY}"}, {"X-API-Key": OTHER_KEY}
    form = {"files": {"frame": frame(0)}, "data": {"box": ",".join(map(str, BOX)), "options": json.dumps(PAPER)}}
    tape.call("POST", "/v1/sessions", note="no key", **form)
    tape.call("GET", "/v1/sessions", headers={"Authorization": "Bearer wrong-key-0123456789"})
    made = tape.call("POST", "/v1/sessions", headers=mine, note="form", **form)
    sid = _named(tape, made.json()["id"])
    for headers in (mine, other):
        tape.call("GET", f"/v1/sessions/{sid}", headers=headers)
    second = tape.call("POST", "/v1/sessions", headers=mine, note="form", **form).json()["id"]
    _named(tape, second)
    tape.call("POST", "/v1/sessions", headers=mine, note="one more than a key may have", **form)
    path = f"/v1/sessions/{sid}/ticket"
    ticket = tape.call("POST", path, headers=mine).json()["ticket"]
    tape.name(ticket, "ticket")
    body = plain({"ttl_s": 5})
    body["headers"] |= mine | {"Accept": "application/msgpack"}
    tape.name(msgpack.unpackb(tape.call("POST", path, **body).content)["ticket"], "ticket")
    for ttl_s in (301, 0, "5", True):
        body = plain({"ttl_s": ttl_s})
        body["headers"] |= mine
        tape.call("POST", path, **body)
    with tape.stream(sid, "mode=lossless", f"mfcmt.ticket.{ticket}, {JSON}", Origin="https://app.example") as talk:
        talk.hear()
        talk.frame(frame(1), "1")
        talk.frame(frame(2), "2, above the credit")
        for _ in range(2):
            talk.hear()
        talk.frame(frame(3) + bytes(65536), "3, too large")
        talk.hear()
        _refused(tape, second, Authorization=f"Bearer {KEY}")
    _refused(tape, sid, "", f"mfcmt.ticket.{ticket}, {JSON}")
    with tape.stream(sid, "", JSON, Origin="https://evil.example", Authorization=f"Bearer {KEY}") as talk:
        talk.hear()
        talk.closed()
    tape.call("GET", "/v1/sessions", headers=mine | {"Origin": "https://app.example"})
    tape.call("GET", "/v1/sessions", headers=mine | {"Origin": "https://evil.example"})
    preflight = {"Origin": "https://app.example", "Access-Control-Request-Method": "PUT"}
    tape.call("OPTIONS", f"/v1/sessions/{sid}/targets/0", headers=preflight)
    tape.call("GET", "/v1/capabilities", headers=mine)
    too_large = bytes(200_000)
    body = {"content": too_large, "headers": mine | {"Content-Type": "image/jpeg"}}
    tape.call("POST", f"/v1/sessions/{sid}/frames", note="200,000 bytes", **body)
    body = {"content": too_large, "headers": mine | {"Content-Type": "application/json"}}
    tape.call("PUT", f"/v1/sessions/{sid}/targets/0", note="200,000 bytes", **body)


SCENARIOS: dict[str, tuple[str, Scenario]] = {
    scenario.__name__: (server, scenario)
    for server, scenario in (
        ("open", service),
        ("open", sessions),
        ("open", frames),
        ("open", targets),
        ("open", trajectory),
        ("open", snapshots),
        ("open", refusals),
        ("open", stream_json),
        ("open", stream_msgpack),
        ("open", handshakes),
        ("open", regions),
        ("open", rescale),
        ("keyed", keys),
    )
}


def restart(server: OwnServer) -> str:
    """A stream is told that the server goes away, and resumed when it is back; the transcript."""
    tape = Tape(server.url)
    sid = create(tape, BOX, OTHER)
    with tape.stream(sid, "mode=lossless") as talk:
        name = talk.hear()["attachment"]
        talk.frame(frame(1), "1")
        talk.hear()
        tape.say("SIGTERM")
        os.kill(server.pid, signal.SIGTERM)
        talk.hear()
        talk.closed()
    _wait_for_end(server)
    server.start()
    with tape.stream(sid, f"mode=lossless&resume={name}") as talk:
        talk.hear()
        talk.frame(frame(2), "2")
        talk.hear()
    tape.call("GET", f"/v1/sessions/{sid}/trajectory?after=0")
    tape.say("SIGKILL")
    os.kill(server.pid, signal.SIGKILL)
    _wait_for_end(server)
    server.start()
    with tape.stream(sid, "mode=lossless", MSGPACK) as talk:
        talk.hear()
        talk.frame(frame(3), "3")
        talk.hear()
        tape.call("GET", f"/v1/sessions/{sid}")
    return tape.text


def _wait_for_end(server: OwnServer) -> None:
    while server.exit_code is None:
        time.sleep(0.02)
    server.stop()


def run(name: str, server: OwnServer) -> str:
    """Play one scenario; its transcript."""
    tape = Tape(server.url)
    SCENARIOS[name][1](tape)
    tape.end_sessions()
    return tape.text
