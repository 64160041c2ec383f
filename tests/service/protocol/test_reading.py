"""Messages and bodies from outside: whatever the bytes, an answer of the catalogue and bounded work."""

from __future__ import annotations

import json
import math
from typing import Any

import msgpack
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from jsonschema_rs import Draft202012Validator

from service.protocol.codecs import JsonReader, MsgpackReader, ReceivedFrame
from service.protocol.documents import Unreadable, from_json, from_msgpack, to_json
from service.protocol.problems import CATALOGUE, ProblemError
from service.protocol.requests import CONTROLS, STREAM_MESSAGES, Add, Control, Correct, Meta, Remove, command
from service.protocol.schema import REF, schemas

KINDS: dict[str, type] = {Meta.TYPE: Meta, **CONTROLS}
SCHEMAS = schemas(STREAM_MESSAGES)
numbers = st.one_of(st.integers(-10, 2**54), st.floats(allow_nan=True), st.booleans(), st.just(10**400))
scalars = st.one_of(st.none(), numbers, st.text(max_size=70))
boxes = st.one_of(scalars, st.lists(st.one_of(numbers, st.floats(1, 900)), max_size=5))
regions = st.one_of(scalars, st.lists(st.one_of(st.integers(0, 900), numbers), min_size=3, max_size=5))
maps = st.fixed_dictionaries(
    {"type": st.one_of(st.sampled_from([*KINDS, "frame", "jump"]), scalars)},
    optional={
        "box": boxes,
        "target": scalars,
        "ref": scalars,
        "on": st.one_of(st.just("next"), scalars),
        "seq": scalars,
        "ts": scalars,
        "region": regions,
        "more": scalars,
    },
)


def read(reader: Any, sent: str | bytes) -> Any:
    """What the reader makes of it, or the code of the refusal."""
    try:
        return reader(sent, None) if isinstance(sent, str) else reader(None, sent)
    except Unreadable:
        return "unreadable"
    except ProblemError as refused:
        body = from_json(to_json(refused.body()))
        assert body["code"] in CATALOGUE
        return body["code"]


@given(st.binary(max_size=400))
@example(b"")
@example(b"\xc1")
@example(b"\x91" * 100_000)
@example(b"\xdf\xff\xff\xff\xff")
@example(b"\xdd\x7f\xff\xff\xff")
@example(b"\xd6\xff\x00\x00\x00\x01")
@example(b"\x82\xa4type\xa3add\xa4type\xa3add")
@example(b"\x81\x01\x02")
@example(b"\x81\xa4type\xd9\x04\xff\xff\xff\xff")
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    for outcome in (read(MsgpackReader(65536), data), read(JsonReader(65536), data.decode("latin-1"))):
        assert outcome in ("unreadable", *CATALOGUE) or isinstance(outcome, Control | ReceivedFrame)


@given(maps)
def test_maps_are_read_as_the_schemas_say(message: dict[str, Any]) -> None:
    """The checks of the fields and the schemas of both contracts agree on what is a message."""
    message = {name: value for name, value in message.items() if value == value}
    message.setdefault("type", None)
    outcome = read(JsonReader(65536), json.dumps(message))
    kind = KINDS.get(message["type"]) if isinstance(message["type"], str) else None
    if kind is None:
        assert outcome in ("bad-request", "unreadable")
        return
    schema = {"$ref": REF.format(model=kind.__name__), "components": {"schemas": SCHEMAS}}
    valid = outcome != "unreadable" and Draft202012Validator(schema).is_valid(message)
    taken = outcome is None or isinstance(outcome, Control)
    if valid:
        assert taken or _is_beyond_a_double(message), (message, outcome)
    if taken:
        assert valid or _has_what_the_lane_refuses(message), (message, outcome)


def _is_beyond_a_double(message: dict[str, Any]) -> bool:
    """Integers that no float holds, or whole floats where an integer is meant: a schema cannot tell them apart."""
    values = [value for one in message.values() for value in (one if isinstance(one, list) else [one])]
    return any(isinstance(v, int) and abs(v) > 2**53 for v in values) or any(isinstance(v, float) for v in values)


def _has_what_the_lane_refuses(message: dict[str, Any]) -> bool:
    """A region that begins left of or above the frame."""
    return any(isinstance(v, int) and v < 0 for v in message.get("region") or ())


@given(st.dictionaries(st.sampled_from(["type", "frame", "seq", "ts", "region"]), scalars | st.binary(max_size=9)))
def test_msgpack_frames(message: dict[str, Any]) -> None:
    message["type"] = "frame"
    try:
        data = msgpack.packb(message)
    except OverflowError:
        return
    outcome = read(MsgpackReader(65536), data)
    assert outcome == "unreadable" or isinstance(outcome, ReceivedFrame)
    if isinstance(outcome, ReceivedFrame) and outcome.problem is None:
        assert outcome.data == message["frame"]


def test_numbers_of_any_kind_in_a_box() -> None:
    for value, code in ((math.inf, "bad-box"), (-math.inf, "bad-box"), (math.nan, "bad-box"), ("nan", "bad-request")):
        data = msgpack.packb({"type": "add", "box": [value, 1, 2, 3]})
        assert read(MsgpackReader(65536), data) == code
    control = read(MsgpackReader(65536), msgpack.packb({"type": "add", "box": [-0.0, 5e-324, 1, 2**60]}))
    assert control.box == [0.0, 5e-324, 1.0, float(2**60)]


def test_a_lane_is_told_what_to_do_and_not_whom_to_answer() -> None:
    assert command(Add([1, 2, 3, 4], ref="a", on="next")) == {"type": "add", "box": [1, 2, 3, 4]}
    assert command(Correct(7, [1, 2, 3, 4])) == {"type": "correct", "target": 7, "box": [1, 2, 3, 4]}
    assert command(Remove(7)) == {"type": "remove", "target": 7}


@pytest.mark.parametrize(
    "bomb",
    [
        msgpack.packb([[0] * 250] * 10),
        msgpack.packb([[[0] * 200] * 200] * 200),
        msgpack.packb({"a": [{"b": [1] * 100}] * 200}),
        b"\x9f" * 5 + b"\x01" * 3_000_000,
        b"\x8f" + (b"\xa1a" + b"\x9f" + b"\x9f" * 15) * 15,
        msgpack.packb([0] * 257),
        msgpack.packb({str(n): n for n in range(33)}),
    ],
)
def test_bombs_are_refused_on_the_way(bomb: bytes) -> None:
    with pytest.raises(Unreadable):
        from_msgpack(bomb)


def test_json_is_rfc_8259() -> None:
    for text in ("NaN", "[Infinity]", '{"a":1,"a":2}', "[" * 100_000, "1" * 5000, "", "{'a':1}"):
        with pytest.raises(Unreadable):
            from_json(text)
    assert from_json('{"a":[1.5,"é"]}') == {"a": [1.5, "é"]}
    assert to_json({"a": b"\x00\x01"}) == '{"a":"AAE="}'
    with pytest.raises(ValueError, match="JSON"):
        to_json({"a": math.nan})
