"""Exchanges over streams, and with keys, that are recorded."""

from __future__ import annotations

import json

import msgpack
from websockets.exceptions import InvalidStatus

from .calls import KEY, OTHER, OTHER_KEY, PAPER, create, larger, named, plain, raw
from .tape import BOX, JSON, MSGPACK, Tape, frame


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
        talk.frame(larger(), "of another size", ts=1.25)
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
    body = {"content": larger(), "headers": {"Content-Type": "image/png"}}
    tape.call("POST", f"/v1/sessions/{sid}/frames", note="another size", **body)


def keys(tape: Tape) -> None:
    """With keys: who may do what, tickets, origins, quotas and limits."""
    mine, other = {"Authorization": f"Bearer {KEY}"}, {"X-API-Key": OTHER_KEY}
    form = {"files": {"frame": frame(0)}, "data": {"box": ",".join(map(str, BOX)), "options": json.dumps(PAPER)}}
    tape.call("POST", "/v1/sessions", note="no key", **form)
    tape.call("GET", "/v1/sessions", headers={"Authorization": "Bearer wrong-key-0123456789"})
    made = tape.call("POST", "/v1/sessions", headers=mine, note="form", **form)
    sid = named(tape, made.json()["id"])
    for headers in (mine, other):
        tape.call("GET", f"/v1/sessions/{sid}", headers=headers)
    second = tape.call("POST", "/v1/sessions", headers=mine, note="form", **form).json()["id"]
    named(tape, second)
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
        with tape.lane_suspended():
            talk.frame(frame(1), "1")
            talk.frame(frame(2), "2, above the credit")
            talk.hear()
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
