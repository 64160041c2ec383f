"""Messages in one frame of the WebSocket protocol (RFC 6455, section 5.2), read and written as a whole.

Nearly all messages of a stream are such. The parser would copy each of them three times.
"""

from __future__ import annotations

import struct
from typing import Any

from websockets import frames

_parser: Any = frames
apply_mask = _parser.apply_mask  # before paced_reader gives the parser another

MASK_BYTES = 4
# The first byte of a frame that is a whole message: the last one of it, without extensions.
TEXT, BINARY = 0x81, 0x82
MASKED = 0x80
# A length above the first of these takes two bytes more, one above the second eight.
SHORT, MEDIUM = 125, 0xFFFF


def whole_message(data: bytes, most: int) -> bytes | None:
    """Return the binary message of at most ``most`` bytes whose frame ``data`` is; None if it is anything else."""
    if len(data) < 2 + MASK_BYTES or data[0] != BINARY or not data[1] & MASKED:
        return None
    size, at = data[1] ^ MASKED, 2
    if size > SHORT:
        at = 4 if size == SHORT + 1 else 10
        size = int.from_bytes(data[2:at])
    begin = at + MASK_BYTES
    if size > most or len(data) != begin + size:
        return None
    message: bytes = apply_mask(memoryview(data)[begin:], data[at:begin])
    return message


def head_of(message: bytes, first: int) -> bytes:
    """Return what stands before ``message`` in its frame, unmasked; ``first`` is :data:`TEXT` or :data:`BINARY`."""
    size = len(message)
    if size <= SHORT:
        return bytes((first, size))
    return struct.pack("!BBH", first, 126, size) if size <= MEDIUM else struct.pack("!BBQ", first, 127, size)
