"""MessagePack as text that shows every byte which a value does not determine: the widths of its heads."""

from __future__ import annotations

import json
import struct

# Heads by their first byte: the kind, and the width in bytes of the length or number that follows.
_HEADS = {
    0xC4: ("bin", 1), 0xC5: ("bin", 2), 0xC6: ("bin", 4), 0xCA: ("float", 4), 0xCB: ("float", 8),
    0xCC: ("uint", 1), 0xCD: ("uint", 2), 0xCE: ("uint", 4), 0xCF: ("uint", 8),
    0xD0: ("int", 1), 0xD1: ("int", 2), 0xD2: ("int", 4), 0xD3: ("int", 8),
    0xD9: ("str", 1), 0xDA: ("str", 2), 0xDB: ("str", 4), 0xDC: ("array", 2), 0xDD: ("array", 4),
    0xDE: ("map", 2), 0xDF: ("map", 4),
}  # fmt: skip
_CONSTANTS = {0xC0: "null", 0xC2: "false", 0xC3: "true"}
_FLOATS = {4: ">f", 8: ">d"}


def text_of(data: bytes) -> str:
    """Return ``data`` as one line that looks like JSON.

    A head that is wider than its value needs, which no packer of ours writes, is shown before the value, as in
    ``uint4:7``. So two documents have the same text only if they have the same bytes, but for the bytes of images.
    """
    text, end = _value(data, 0)
    if end != len(data):
        raise ValueError(f"{len(data) - end} bytes behind the value")
    return text


def _value(data: bytes, at: int) -> tuple[str, int]:
    first = data[at]
    at += 1
    if first in _CONSTANTS:
        return _CONSTANTS[first], at
    if first < 0x80:
        return str(first), at
    if first >= 0xE0:
        return str(first - 0x100), at
    if first < 0xC0:
        kind, size = (
            ("map", first & 15) if first < 0x90 else ("array", first & 15) if first < 0xA0 else ("str", first & 31)
        )
        return _container(data, at, kind, size)
    kind, width = _HEADS[first]
    end = at + width
    if kind == "float":
        (number,) = struct.unpack_from(_FLOATS[width], data, at)
        return ("" if width == 8 else "float4:") + repr(number), end
    size = int.from_bytes(data[at:end], "big", signed=kind == "int")
    needed = _needed(kind, size)
    wide = "" if width == needed else f"{kind}{width}:"
    if kind in ("uint", "int"):
        return f"{wide}{size}", end
    text, end = _container(data, end, kind, size)
    return wide + text, end


def _needed(kind: str, size: int) -> int:
    """The width that the shortest head of a value has; 0 where it has none beside its first byte."""
    if kind == "int":
        return (
            0
            if size >= -32
            else 1
            if size >= -(1 << 7)
            else 2
            if size >= -(1 << 15)
            else 4
            if size >= -(1 << 31)
            else 8
        )
    within = {"uint": 1 << 7, "str": 32, "array": 16, "map": 16, "bin": 0}[kind]
    if size < within:
        return 0
    widths = (2, 4) if kind in ("array", "map") else (1, 2, 4, 8)
    return next(width for width in widths if size < 1 << (8 * width))


def _container(data: bytes, at: int, kind: str, size: int) -> tuple[str, int]:
    if kind == "str":
        return json.dumps(data[at : at + size].decode(), ensure_ascii=False), at + size
    if kind == "bin":
        return f"<{image_or_bytes(data[at : at + size])}>", at + size
    parts = []
    for _ in range(size):
        part, at = _value(data, at)
        if kind == "map":
            value, at = _value(data, at)
            part += ":" + value
        parts.append(part)
    opening, closing = "{}" if kind == "map" else "[]"
    return opening + ",".join(parts) + closing, at


def image_or_bytes(data: bytes) -> str:
    """Describe a PNG by its size in pixels, anything else by its length: their pixels are the tracker's business."""
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        width, height = struct.unpack_from(">II", data, 16)
        return f"png {width}x{height}"
    return f"{len(data)} bytes"
