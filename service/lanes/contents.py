"""A session's state as bytes: its checkpoints, which stay in the service, and its snapshots, which clients hold.

The contents are one map. What a client sends in is checked against the types of the protocol before it is used.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from enum import StrEnum
from math import isfinite
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import msgpack
from annotated_types import Gt

from mfcmt_core.images import FrameError, FrameLimits, inspect
from mfcmt_core.snapshot import parse

from ..protocol.requests import LEAST_IDLE_S, Options
from ..protocol.target import ROW_FIELDS, Target, complete

FIELDS = {"options", "targets", "next_id", "seq", "size", "newest", "newest_at", "want_full"}
MAX_INTEGER = 2**53
# Numbers of a snapshot stay below this, so that no sum or product of a few of them overflows.
MAX_NUMBER = 1e12
# The bounds and the types of the fields, as the classes define them.
_BOUNDS = {kind: {one.name: one.metadata for one in fields(kind)} for kind in (Target, Options)}
_TYPES = {kind: get_type_hints(kind, include_extras=True) for kind in (Target, Options)}


def pack(contents: dict[str, Any]) -> bytes:
    """Return the contents as bytes that :func:`unpack` reads."""
    data: bytes = msgpack.packb(contents)
    return data


def unpack(data: bytes) -> dict[str, Any]:
    """Return the contents in the present layout. Raises ValueError for bytes that are none.

    The first snapshots kept the label and the idle time apart from the other options, as ``front``.
    """
    try:
        contents: dict[str, Any] = msgpack.unpackb(data)
        if "front" in contents:
            contents["options"] = {**contents["options"], **contents.pop("front")}
    except (TypeError, KeyError, AttributeError, RecursionError, msgpack.UnpackException) as wrong:
        raise ValueError("no map of these contents") from wrong
    return contents


def options_of(contents: dict[str, Any]) -> Options:
    """Return the session's options. Raises TypeError for options that do not exist."""
    return Options(**contents["options"])


def check(contents: dict[str, Any], limits: FrameLimits, max_targets: int) -> None:
    """Check contents that a client sent in. Raises ValueError or BadSnapshot, whatever is wrong with them."""
    try:
        _check(contents, limits, max_targets)
    except (TypeError, KeyError, AttributeError, RecursionError, FrameError) as wrong:
        raise ValueError("not the contents of a snapshot") from wrong


def _check(contents: dict[str, Any], limits: FrameLimits, max_targets: int) -> None:
    _require(contents.keys() == FIELDS)
    options, idle_s = contents["options"], contents["options"]["idle_timeout_s"]
    # A service whose own idle time is shorter than what clients may ask for makes sessions with it.
    _require(options.keys() == _BOUNDS[Options].keys() and idle_s > 0)
    _check_values(Options, options | {"idle_timeout_s": max(idle_s, LEAST_IDLE_S)})
    _require(type(contents["want_full"]) is bool)
    _check_integer(contents["seq"])
    _check_frame(contents, limits)
    targets, next_id = contents["targets"], _check_integer(contents["next_id"])
    _require(type(targets) is list and len(targets) <= max_targets)
    for row, tracker in targets:
        _check_values(Target, dict(zip(ROW_FIELDS, complete(row), strict=True)))
        _require(_check_integer(row[0]) < next_id and parse(tracker)[2] == tuple(contents["size"]))
    _require(len({row[0] for row, _ in targets}) == len(targets))


def _check_frame(contents: dict[str, Any], limits: FrameLimits) -> None:
    """Check that the newest frame is an image, and lies in the whole frame where the contents say."""
    width, height = map(_check_integer, contents["size"])
    x, y = map(_check_integer, contents["newest_at"])
    _require(type(contents["newest"]) is bytes)
    image = inspect(contents["newest"], limits)
    _require(width <= limits.max_side and height <= limits.max_side and width * height <= limits.max_pixels)
    _require(x + image.width <= width and y + image.height <= height)


def _check_values(kind: type[Target] | type[Options], values: dict[str, Any]) -> None:
    """Check each value against the type and the bounds of the field of ``kind`` that has its name."""
    for name, value in values.items():
        _require(_fits(value, _TYPES[kind][name]))
        bounds = _BOUNDS[kind][name]
        if type(value) in (int, float):
            _require(bounds.get("ge", value) <= value <= bounds.get("le", value))
            _require(value > bounds.get("gt", -MAX_NUMBER))
        elif type(value) is str:
            _require(len(value) <= bounds.get("max_length", len(value)))


def _fits(value: Any, expected: Any) -> bool:
    """Return whether a plain value is of a type of the protocol: what is an object there is a list here."""
    origin, parts = get_origin(expected), get_args(expected)
    if origin is Annotated:
        return _fits(value, parts[0]) and all(value > one.gt for one in parts[1:] if isinstance(one, Gt))
    if origin in (Union, UnionType):
        return any(_fits(value, part) for part in parts)
    if is_dataclass(expected):
        origin, parts = tuple, tuple(get_type_hints(expected).values())
    if origin is tuple:
        return type(value) is list and len(value) == len(parts) and all(map(_fits, value, parts))
    if expected is NoneType:
        return value is None
    if expected is float:
        return type(value) in (int, float) and isfinite(value) and abs(value) < MAX_NUMBER
    if issubclass(expected, StrEnum):
        return type(value) is str and value in set(expected)
    return type(value) is expected


def _check_integer(value: Any) -> int:
    _require(type(value) is int and 0 <= value < MAX_INTEGER)
    return int(value)


def _require(condition: bool) -> None:
    if not condition:
        raise ValueError("not the contents of a snapshot")
