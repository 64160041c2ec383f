"""Bad inputs by a seed: damaged good ones, and invented ones that resemble good ones."""

from __future__ import annotations

import json
import random
import struct
from typing import Any

import cv2
import msgpack

from mfcmt_core.images import FrameLimits
from mfcmt_core.images.decode import decode

FLOATS = [0.0, -0.0, 1.0, -1.0, 1e-308, 5e-324, 1e308, float("nan"), float("inf"), float("-inf"), 2.0**53, 0.1]
VALUES: list[Any] = [None, True, False, 0, -1, 2**53, 2**63, -(2**63), "", "x" * 300, "\u0000", [], {}, [[]], {"": 0}]
PATHS = [
    "/v1/sessions/{sid}/frames",
    "/v1/sessions/{sid}/targets",
    "/v1/sessions/{sid}/targets/0",
    "/v1/sessions/{sid}/ticket",
    "/v1/sessions/{sid}/trajectory",
    "/v1/sessions/{sid}",
    "/v1/sessions",
    "/v1/capabilities",
]
METHODS = ["GET", "POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "get", "FRAME"]


class Mutator:
    """Makes inputs that depend on ``seed`` alone."""

    def __init__(self, seed: int, jpeg: bytes) -> None:
        self.chance = random.Random(seed)
        pixels = decode(jpeg, FrameLimits())[0]
        self.images = [jpeg, *(cv2.imencode(kind, pixels)[1].tobytes() for kind in (".png", ".webp"))]

    def damaged(self, data: bytes) -> bytes:
        """``data`` with bits flipped, a part cut out, doubled, overwritten or exchanged, or the end missing."""
        chance, broken = self.chance, bytearray(data)
        for _ in range(chance.choice((1, 1, 1, 2, 8))):
            if not broken:
                break
            at = chance.randrange(min(len(broken), chance.choice((16, 64, len(broken)))) or 1)
            length = chance.randrange(1, 64)
            match chance.randrange(6):
                case 0:
                    broken[at] ^= 1 << chance.randrange(8)
                case 1:
                    broken[at : at + length] = chance.randbytes(length)
                case 2:
                    del broken[at : at + length]
                case 3:
                    broken[at:at] = broken[at : at + length]
                case 4:
                    del broken[chance.randrange(len(broken)) :]
                case _:
                    broken[at : at + 2] = struct.pack(">H", chance.choice((0, 1, 0x7FFF, 0xFFFF)))
        return bytes(broken)

    def frame(self) -> bytes:
        """An image of one of the kinds, damaged."""
        return self.damaged(self.chance.choice(self.images))

    def value(self, depth: int = 2) -> Any:
        """Anything that JSON or MessagePack can say, and some that only one of them can."""
        chance = self.chance
        match chance.randrange(6 if depth else 3):
            case 0:
                return chance.choice(FLOATS)
            case 1 | 2:
                return chance.choice(VALUES)
            case 3:
                return [self.value(depth - 1) for _ in range(chance.randrange(6))]
            case 4:
                return [chance.uniform(-50, 200) for _ in range(4)]
            case _:
                return {chance.choice(("box", "type", "seq", "x")): self.value(depth - 1) for _ in range(3)}

    def changed(self, good: dict[str, Any]) -> dict[str, Any]:
        """``good`` with a field changed, missing or too many."""
        chance, fields = self.chance, dict(good)
        match chance.randrange(4):
            case 0:
                fields.pop(chance.choice(list(fields)))
            case 1:
                fields[chance.choice(("extra", "Type", "frame ", "__class__"))] = self.value()
            case _:
                fields[chance.choice(list(fields))] = self.value()
        return fields

    def packed(self, fields: Any, kind: str) -> bytes:
        """``fields`` as JSON or MessagePack, now and then damaged."""
        data = json.dumps(fields, default=repr).encode() if kind.endswith("json") else _msgpack(fields)
        return self.damaged(data) if self.chance.random() < 0.3 else data

    def head(self, sid: str) -> bytes:
        """An HTTP request as bytes, damaged."""
        chance = self.chance
        path = chance.choice(PATHS).format(sid=chance.choice((sid, "x", "../" * 5 + "etc/passwd", "%00", "a" * 3000)))
        length = chance.choice(
            ("", "Content-Length: 3\r\n", "Transfer-Encoding: chunked\r\n", "Upgrade: websocket\r\n")
        )
        text = f"{chance.choice(METHODS)} {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{length}\r\n{{}}\n"
        return self.damaged(text.encode())


def _msgpack(fields: Any) -> bytes:
    try:
        data: bytes = msgpack.packb(fields)
    except (OverflowError, ValueError):
        data = msgpack.packb(repr(fields))
    return data
