"""JSON and MessagePack; documents from outside are bounded in depth and width, and so in the time they take."""

from __future__ import annotations

import base64
import json
from typing import Any, NoReturn

import msgpack

MAX_ITEMS = 256
MAX_KEYS = 32
MAX_ITEMS_IN_ALL = 2048
MAX_TEXT_BYTES = 64 * 1024


class Unreadable(Exception):
    """The bytes are no document of this format, or one beyond its bounds; the text says why."""


def from_json(text: str | bytes, most: int = MAX_ITEMS_IN_ALL) -> Any:
    """Return the value of a JSON document (RFC 8259: no NaN, no doubled keys) of ``most`` items. Raises Unreadable.

    Commas and brackets are counted before it is read, also those in texts.
    """
    if len(text) > most:
        comma, opening = (b",", (b"[", b"{")) if isinstance(text, bytes) else (",", ("[", "{"))
        if text.count(comma) + sum(map(text.count, opening)) > most:  # type: ignore[arg-type]
            raise Unreadable("too many items")
    try:
        return json.loads(text, parse_constant=_refuse, object_pairs_hook=_unique)
    except (ValueError, RecursionError) as broken:
        raise Unreadable("not a JSON document") from broken


def from_msgpack(data: bytes | memoryview) -> Any:
    """Return the value of a MessagePack document. Raises Unreadable, for extension types too.

    Items are counted as they are read, so that a document that is too wide or too deep is refused on the way.
    """
    budget = _Budget()
    try:
        return msgpack.unpackb(
            data,
            raw=False,
            strict_map_key=True,
            max_str_len=MAX_TEXT_BYTES,
            max_array_len=MAX_ITEMS,
            max_map_len=MAX_KEYS,
            max_ext_len=0,
            ext_hook=_refuse,
            list_hook=budget.items,
            object_pairs_hook=budget.pairs,
        )
    except (ValueError, TypeError, msgpack.UnpackException) as broken:
        raise Unreadable("not a MessagePack document") from broken


def to_json(value: Any) -> str:
    """Return ``value`` as one line of JSON, with bytes as base64. Raises ValueError for NaN and infinity."""
    return _encode(value)


def to_msgpack(value: Any) -> bytes:
    """Return ``value`` as MessagePack."""
    packed: bytes = msgpack.packb(value)
    return packed


def _base64(value: object) -> str:
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    raise TypeError(f"{type(value).__name__} is not of the protocol")


# json.dumps would make an encoder for each message.
_encode = json.JSONEncoder(separators=(",", ":"), default=_base64, allow_nan=False).encode


def _refuse(*_: Any) -> NoReturn:
    raise ValueError("not allowed here")


def _unique(pairs: list[tuple[Any, Any]]) -> dict[Any, Any]:
    value = dict(pairs)
    if len(value) != len(pairs):
        raise ValueError("a key is doubled")
    return value


class _Budget:
    """Counts how many items one document may still have, in all its containers together."""

    __slots__ = ("_left",)

    def __init__(self) -> None:
        self._left = MAX_ITEMS_IN_ALL

    def items(self, items: list[Any]) -> list[Any]:
        self._left -= len(items)
        if self._left < 0:
            raise ValueError("too many items")
        return items

    def pairs(self, pairs: list[tuple[Any, Any]]) -> dict[Any, Any]:
        value = dict(pairs)
        self._left -= len(pairs)
        if self._left < 0 or len(value) != len(pairs):
            raise ValueError("too many items, or a key is doubled")
        return value
