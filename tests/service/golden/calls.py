"""Exchanges over HTTP that are recorded, and the bodies that they send."""

from __future__ import annotations

import base64
import json
from typing import Any

import msgpack

from .tape import BOX, Tape, frame

PAPER = {"preset": "paper"}
AS_JSON = {"Content-Type": "application/json"}
OTHER = [100.0, 60.0, 24.0, 20.0]
KEY, OTHER_KEY = "golden-key-0123456789", "another-key-0123456789"


def create(tape: Tape, *boxes: Any, **options: Any) -> str:
    """Make a session from frame 0 by a form; its id."""
    data = {"boxes": json.dumps(list(boxes) or [BOX]), "options": json.dumps(PAPER | options)}
    note = f"form: frame 0, {data['boxes']}, {data['options']}"
    response = tape.call("POST", "/v1/sessions", note=note, files={"frame": frame(0)}, data=data)
    return named(tape, response.json()["id"])


def named(tape: Tape, sid: str) -> str:
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
    first = named(tape, response.json()["id"])
    second = create(tape, BOX, OTHER, label='Größe "1"', idle_timeout_s=60, maps=True, on_resize="rescale")
    text = base64.b64encode(frame(0)).decode()
    body = plain({"frame": text, "box": BOX, "options": PAPER}) | {"note": "JSON: frame 0 in base64, box"}
    named(tape, tape.call("POST", "/v1/sessions", **body).json()["id"])
    body = packed({"frame": frame(0), "boxes": [BOX], "options": PAPER})
    body["headers"] |= {"Accept": "application/msgpack", "Idempotency-Key": "once"}
    made = tape.call("POST", "/v1/sessions", note="MessagePack: frame 0, boxes", **body)
    last = named(tape, msgpack.unpackb(made.content)["id"])
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
    again = named(tape, restored.json()["id"])
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
    tape.call("POST", path, content=larger(), headers={"Content-Type": "image/png"}, note="a frame of another size")
    with tape.stream(sid) as talk:
        talk.hear()
        tape.call("POST", path, **raw(2))


def larger() -> bytes:
    import cv2
    import numpy as np

    return cv2.imencode(".png", np.zeros((100, 100), np.uint8))[1].tobytes()
