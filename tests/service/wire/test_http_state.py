"""What a session gives out over HTTP: its past, snapshots, response maps."""

from __future__ import annotations

import base64
import csv
import io
from typing import Any

import httpx2
import msgpack

from mfcmt_core.images.decode import decode
from service.load.clips import LIMITS, Clip

from .conftest import Serve, Wire, problem

SNAPSHOT = "application/vnd.mfcmt.snapshot"


async def test_the_trajectory_is_given_in_four_formats(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box)
    path = f"/v1/sessions/{session['id']}"
    results = [(await wire.track(session["id"], f, ts=f"t,{n}")).json() for n, f in enumerate(clip.frames[1:40])]
    await wire.http.post(f"{path}/targets", json={"box": list(clip.box)})
    results += [(await wire.track(session["id"], f)).json() for f in clip.frames[40:45]]

    async def past(**params: Any) -> httpx2.Response:
        response = await wire.http.get(f"{path}/trajectory", params=params)
        assert response.status_code == 200, response.text
        return response

    answer = (await past()).json()
    assert answer["id"] == session["id"]
    assert [r["seq"] for r in answer["results"]] == list(range(45))
    assert answer["results"][0]["targets"] == session["targets"]
    for was, is_ in zip(results[40:], answer["results"][41:], strict=False):
        assert all(is_[name] == was[name] for name in ("seq", "ts", "size", "region", "targets"))
    assert len(answer["results"][39]["targets"]) == 2  # the box added on the newest frame belongs to it
    assert [r["seq"] for r in (await past(after=42)).json()["results"]] == [43, 44]
    packed = await wire.http.get(f"{path}/trajectory", headers={"Accept": "application/msgpack"})
    assert msgpack.unpackb(packed.content) == answer
    rows = list(csv.DictReader(io.StringIO((await past(format="csv", target=0)).text)))
    assert [int(row["seq"]) for row in rows] == list(range(45))
    assert (rows[3]["ts"], rows[3]["status"]) == ("t,2", answer["results"][3]["targets"][0]["status"])
    boxes = [r["targets"][0]["box"] for r in answer["results"]]
    otb = (await past(format="otb", target=0)).text.splitlines()
    assert [[float(v) for v in line.split(",")] for line in otb] == [[b[0] + 1, b[1] + 1, b[2], b[3]] for b in boxes]
    assert len((await past(format="otb", target=1)).text.splitlines()) == 6
    mot = [line.split(",") for line in (await past(format="mot")).text.splitlines()]
    assert len(mot) == 45 + 6
    assert mot[0][:3] == ["1", "1", str(boxes[0][0] + 1)]
    assert all(len(row) == 10 and 0 <= float(row[6]) <= 1 for row in mot)
    assert problem(await wire.http.get(f"{path}/trajectory", params={"format": "otb"})) == (400, "bad-request")
    assert problem(await wire.http.get(f"{path}/trajectory", params={"format": "voc"})) == (400, "bad-request")


async def test_a_snapshot_goes_on_bit_for_bit(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box, list(clip.box), label="kept", preset="paper", maps=True)
    path = f"/v1/sessions/{session['id']}"
    for frame in clip.frames[1:6]:
        await wire.track(session["id"], frame)
    taken = await wire.http.get(f"{path}/snapshot")
    assert taken.status_code == 200
    assert taken.headers["content-type"] == SNAPSHOT
    restored = await wire.http.post("/v1/sessions", content=taken.content, headers={"Content-Type": SNAPSHOT})
    assert restored.status_code == 201, restored.text
    answer = restored.json()
    assert answer["id"] != session["id"]
    assert (answer["seq"], answer["label"], answer["preset"]) == (5, "kept", "paper")
    assert answer["targets"] == (await wire.http.get(path)).json()["targets"]
    for frame in clip.frames[6:12]:
        one = (await wire.track(session["id"], frame)).json()
        two = (await wire.track(answer["id"], frame)).json()
        assert (one["targets"], one["region"], one["seq"]) == (two["targets"], two["region"], two["seq"])
        assert one["targets"][0]["maps"]
    for broken in (
        b"",
        taken.content[:20],
        taken.content[:-1],
        taken.content[:100] + bytes([taken.content[100] ^ 1]) + taken.content[101:],
        taken.content[:6] + b"\x00\x03" + taken.content[8:],
    ):
        refused = await wire.http.post("/v1/sessions", content=broken, headers={"Content-Type": SNAPSHOT})
        assert problem(refused) == (422, "bad-snapshot")
    refused = await wire.http.get(f"{path}/snapshot", headers={"Accept": "application/json"})
    assert problem(refused) == (406, "not-acceptable")


async def test_response_maps_are_small_images(wire: Wire, clip: Clip) -> None:
    session = await wire.create(clip.frames[0], clip.box, maps=True)
    result = (await wire.track(session["id"], clip.frames[1])).json()
    maps = result["targets"][0]["maps"]
    assert "fused" in maps
    for image in maps.values():
        pixels, info = decode(base64.b64decode(image), LIMITS)
        assert info.kind == "png"
        assert pixels.ndim == 2
        assert pixels.max() == 255


async def test_snapshots_of_a_signing_key_outlive_the_process(serve: Serve, clip: Clip) -> None:
    old, new = "first-signing-key-0001", "second-signing-key-002"
    first = serve(signing_keys=old)
    session = await first.create(clip.frames[0], clip.box)
    data = (await first.http.get(f"/v1/sessions/{session['id']}/snapshot")).content
    rotated, stranger = serve(signing_keys=f"{new},{old}"), serve(signing_keys=new)
    headers = {"Content-Type": SNAPSHOT}
    assert (await rotated.http.post("/v1/sessions", content=data, headers=headers)).status_code == 201
    refused = await stranger.http.post("/v1/sessions", content=data, headers=headers)
    assert problem(refused) == (422, "bad-snapshot")
