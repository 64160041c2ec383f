"""A session's state as bytes: its checkpoints, which never leave the service, and its snapshots, which do.

What comes back from a client is checked field by field before anything is made of it.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import isfinite
from typing import Any

import msgpack

from mfcmt_core.images import FrameError, FrameLimits, inspect
from mfcmt_core.snapshot import parse

PRESETS = ("default", "paper")
RESIZES = ("reject", "rescale")
STATUSES = ("tracking", "uncertain", "lost")
FIELDS = {"options", "targets", "next_id", "seq", "size", "newest", "newest_at", "want_full", "front"}
MAX_INTEGER = 2**53
MAX_LABEL = 200
LARGEST = 1e12


def pack(contents: dict[str, Any]) -> bytes:
    """As bytes that :func:`unpack` reads."""
    data: bytes = msgpack.packb(contents)
    return data


def unpack(data: bytes) -> dict[str, Any]:
    """What :func:`pack` was given, if these are its bytes. Raises ValueError if they are not even MessagePack."""
    try:
        told: dict[str, Any] = msgpack.unpackb(data)
    except (RecursionError, msgpack.UnpackException) as wrong:
        raise ValueError("not MessagePack") from wrong
    return told


def check(contents: Any, limits: FrameLimits, max_targets: int) -> None:
    """Look at what a client sent in. Raises ValueError and BadSnapshot, whatever is wrong with it."""
    try:
        _check(contents, limits, max_targets)
    except (TypeError, KeyError, AttributeError, RecursionError, FrameError) as wrong:
        raise ValueError("not the contents of a snapshot") from wrong


def _check(contents: Any, limits: FrameLimits, max_targets: int) -> None:
    _need(isinstance(contents, dict) and contents.keys() == FIELDS)
    options, front = contents["options"], contents["front"]
    _need(options.keys() == {"preset", "on_resize", "maps"})
    _need(options["preset"] in PRESETS and options["on_resize"] in RESIZES and type(options["maps"]) is bool)
    _need(front.keys() == {"label", "idle_timeout_s"})
    label = front["label"]
    _need(label is None or (type(label) is str and len(label) <= MAX_LABEL))
    _number(front["idle_timeout_s"], above=0)
    _need(type(contents["want_full"]) is bool)
    _integer(contents["seq"])
    _check_frame(contents, limits)
    targets, next_id = contents["targets"], _integer(contents["next_id"])
    _need(type(targets) is list and len(targets) <= max_targets)
    for row, tracker in targets:
        _check_row(row)
        _need(row[0] < next_id and parse(tracker)[2] == tuple(contents["size"]))
    _need(len({row[0] for row, _ in targets}) == len(targets))


def _check_frame(contents: dict[str, Any], limits: FrameLimits) -> None:
    """The newest frame is an image that lies in the frame where it says."""
    width, height = map(_integer, contents["size"])
    x, y = map(_integer, contents["newest_at"])
    _need(type(contents["newest"]) is bytes)
    image = inspect(contents["newest"], limits)
    _need(width <= limits.max_side and height <= limits.max_side and width * height <= limits.max_pixels)
    _need(x + image.width <= width and y + image.height <= height)


def _check_row(row: Any) -> None:
    tid, (x, y, w, h), status, reliable, flags, scores, psr, updated, scale = row
    _integer(tid)
    _number(x), _number(y), _number(w, above=0), _number(h, above=0)
    _need(type(status) is str and status in STATUSES)
    _need(reliable is None or type(reliable) is bool)
    _need(flags is None or (len(flags) == 3 and all(type(flag) is bool for flag in flags)))
    _need(scores is None or len(_numbers(scores)) == 3)
    _need(type(updated) is bool)
    if psr is not None:
        _number(psr)
    _number(scale, above=0)


def _numbers(values: Iterable[Any]) -> list[float]:
    return [_number(value) for value in values]


def _number(value: Any, above: float = -LARGEST) -> float:
    _need(type(value) in (int, float) and isfinite(value) and above < value < LARGEST)
    return float(value)


def _integer(value: Any) -> int:
    _need(type(value) is int and 0 <= value < MAX_INTEGER)
    return int(value)


def _need(condition: bool) -> None:
    if not condition:
        raise ValueError("not the contents of a snapshot")
