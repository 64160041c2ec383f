"""Snapshots whose signature is good and whose contents are not: refused, or a session that works."""

from __future__ import annotations

import random
from typing import Any

import cv2
import msgpack
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mfcmt_core.images import FrameLimits
from service.lanes.contents import FIELDS, pack
from service.lanes.limits import LaneLimits
from service.lanes.operations import LaneOperations
from service.protocol.problems import ProblemError
from service.protocol.target import ROW_FIELDS

LIMITS = LaneLimits(
    FrameLimits(max_bytes=1 << 20, max_pixels=1 << 20, max_side=4096, max_scans=16), max_targets=4, region_lag=1
)
OPTIONS = {"preset": "default", "on_resize": "reject", "label": "kept", "maps": False, "idle_timeout_s": 60.0}


def picture(size: tuple[int, int] = (96, 72)) -> bytes:
    """A textured JPEG."""
    noise = np.random.default_rng(7).integers(0, 255, (size[1] // 4, size[0] // 4, 3), dtype=np.uint8)
    return cv2.imencode(".jpg", cv2.resize(noise, size))[1].tobytes()


@pytest.fixture(scope="module")
def store() -> LaneOperations:
    return LaneOperations(LIMITS)


@pytest.fixture(scope="module")
def sound(store: LaneOperations) -> dict[str, Any]:
    """The contents of a real snapshot, of two targets."""
    store.handle("create", "s", {"options": OPTIONS, "boxes": [[30, 20, 24, 24], [50, 30, 20, 30]]}, picture())
    store.handle("track", "s", {"seq": 1}, picture())
    contents: dict[str, Any] = msgpack.unpackb(store.handle("snapshot", "s", {"options": OPTIONS}, b""))
    assert contents.keys() == FIELDS
    return contents


def restored(store: LaneOperations, data: bytes) -> bool:
    """Whether the lane takes it; if it does, the session works. It refuses in no other way."""
    try:
        state = store.handle("restore", "r", {}, data)
    except ProblemError as refusal:
        refused = refusal
    else:
        return _works(store, state)
    assert (refused.code, refused.members) == ("bad-snapshot", {})
    return False


def _works(store: LaneOperations, state: dict[str, Any]) -> bool:
    store.handle("track", "r", {"seq": state["seq"] + 1}, picture(tuple(state["size"])))
    store.handle("snapshot", "r", {"options": OPTIONS}, b"")
    store.handle("drop", "r", {}, b"")
    return True


def test_sound_snapshot_is_restored(store: LaneOperations, sound: dict[str, Any]) -> None:
    assert restored(store, pack(sound))


@pytest.mark.parametrize(
    "change",
    [
        {"options": OPTIONS | {"preset": "fastest"}},
        {"options": OPTIONS | {"on_resize": "reject "}},
        {"options": OPTIONS | {"maps": 1}},
        {"options": OPTIONS | {"label": 7}},
        {"options": OPTIONS | {"label": "x" * 201}},
        {"options": OPTIONS | {"idle_timeout_s": float("nan")}},
        {"options": OPTIONS | {"idle_timeout_s": -1}},
        {"options": OPTIONS | {"idle_timeout_s": None}},
        {"options": OPTIONS | {"speed": 1}},
        {"options": {"preset": "default", "on_resize": "reject"}},
        {"front": {"label": 7, "idle_timeout_s": 60.0}},
        {"front": None},
        {"next_id": 1},
        {"next_id": -1},
        {"seq": -1},
        {"seq": 2**63},
        {"seq": True},
        {"size": [1 << 20, 1 << 20]},
        {"size": [10, 10]},
        {"size": [96]},
        {"size": [97, 72]},
        {"newest": b""},
        {"newest": b"GIF89a"},
        {"newest": "text"},
        {"newest_at": [-5, 0]},
        {"newest_at": [50, 50]},
        {"want_full": 1},
        {"targets": [[[0, [0, 0, 1, 1], "tracking", None, None, None, None, True, 1.0], b"junk"]]},
        {"targets": {}},
        {"more": 1},
    ],
)
def test_wrong_field_is_refused(store: LaneOperations, sound: dict[str, Any], change: dict[str, Any]) -> None:
    assert not restored(store, pack(sound | change))


def test_targets_are_counted_and_have_different_ids(store: LaneOperations, sound: dict[str, Any]) -> None:
    first, second = sound["targets"]
    assert restored(store, pack(sound | {"targets": [first]}))
    assert not restored(store, pack(sound | {"targets": [first, first]}))
    many = [[[n, *first[0][1:]], first[1]] for n in range(5)]
    assert not restored(store, pack(sound | {"targets": many, "next_id": 9}))
    swapped = [[first[0], second[1]], [second[0], first[1]]]
    assert restored(store, pack(sound | {"targets": swapped}))


@pytest.mark.parametrize(
    "data", [b"", b"\xc1", b"\x80", b"\xdf\xff\xff\xff\xff", b"\x91" * 100_000, msgpack.packb(None)]
)
def test_bytes_that_are_no_snapshot_are_refused(store: LaneOperations, data: bytes) -> None:
    assert not restored(store, data)


values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=8)
    | st.binary(max_size=40),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)


def paths(value: Any, here: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The way to every value inside."""
    found = [here] if here else []
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, one in inner:
        found += paths(one, (*here, name))
    return found


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_fuzz_a_value_inside(store: LaneOperations, sound: dict[str, Any], data: st.DataObject) -> None:
    """Any value, anywhere in the contents or in a tracker of them."""
    contents: dict[str, Any] = msgpack.unpackb(pack(sound))
    inside_tracker = data.draw(st.booleans())
    root: Any = msgpack.unpackb(contents["targets"][0][1]) if inside_tracker else contents
    path = data.draw(st.sampled_from(paths(root)))
    at = root
    for name in path[:-1]:
        at = at[name]
    at[path[-1]] = data.draw(values)
    if inside_tracker:
        contents["targets"][0][1] = msgpack.packb(root)
    restored(store, pack(contents))
    assert restored(store, pack(sound))


def test_fuzz_bytes(store: LaneOperations, sound: dict[str, Any]) -> None:
    """Damage as a disk or a wire would do it, without a signature to tell."""
    packed, chance = pack(sound), random.Random(5)
    for _ in range(150):
        broken = bytearray(packed)
        for _ in range(chance.choice((1, 1, 3, 20))):
            broken[chance.randrange(len(broken))] = chance.randrange(256)
        restored(store, bytes(broken[: chance.choice((len(broken), chance.randrange(len(broken))))]))
    assert restored(store, pack(sound))


def test_first_snapshots_kept_label_and_idle_time_apart(store: LaneOperations, sound: dict[str, Any]) -> None:
    options = {name: OPTIONS[name] for name in ("preset", "on_resize", "maps")}
    front = {"label": "kept", "idle_timeout_s": 60.0}
    state = store.handle("restore", "r", {}, pack(sound | {"options": options, "front": front}))
    assert state["options"] == OPTIONS


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("id", -1), ("id", True), ("id", 0.0), ("box", [1, 2, 3]), ("box", [1, 2, 0, 4]), ("box", [1, 2, 3, 1e13]),
        ("box", [1, 2, 3, float("inf")]), ("status", "gone"), ("status", None), ("reliable", 1), ("flags", [True] * 2),
        ("flags", [1, 1, 1]), ("scores", [1, 2, "3"]), ("scores", {"fused": 1}), ("psr", float("nan")), ("psr", "7"),
        ("updated", None), ("scale", 0), ("scale", True),
    ],
)  # fmt: skip
def test_row_with_a_wrong_value_is_refused(
    store: LaneOperations, sound: dict[str, Any], field: str, value: Any
) -> None:
    [row, tracker], *rest = sound["targets"]
    changed = [value if name == field else old for name, old in zip(ROW_FIELDS, row, strict=True)]
    assert not restored(store, pack(sound | {"targets": [[changed, tracker], *rest]}))
