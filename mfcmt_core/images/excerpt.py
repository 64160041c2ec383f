"""Cut a part out of a JPEG without decoding pixels: a smaller JPEG of the same coded blocks.

To read a JPEG's codes is a fraction of what it costs to make pixels of them. An excerpt has all units from which the
decoder makes the pixels of a rectangle, so these are those of the whole picture, bit for bit. The codes of the rest are
read, too: a JPEG with damaged or missing data has no excerpt.

References
----------
ITU-T Recommendation T.81, annexes B and F.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from ..kernels import excerpt as kernels
from ..workspace import scratch
from . import huffman
from .header import MAX_PARTS

Rect = tuple[int, int, int, int]

_SOS, _DHT, _DQT, _DRI, _COM, _APP0, _APP14 = 0xDA, 0xC4, 0xDB, 0xDD, 0xFE, 0xE0, 0xEE
_SOF = (0xC0, 0xC1)
MARGIN = 2
"""Pixels around a rectangle whose chroma the decoder's interpolation reads."""
_MOST_BLOCKS = 10
"""Largest number of blocks in a unit, by the standard."""
_DC_SIZES = 12
"""Number of sizes that the difference of two DC coefficients has, by the standard."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """What the header of a JPEG says about its coded data, which are one scan.

    ``head`` is the header of an excerpt in two parts, between which its height and width belong. ``blocks``, ``codes``,
    ``quick`` and ``dc_codes`` are arguments of the kernel.
    """

    head: tuple[bytes, bytes]
    size: tuple[int, int]
    unit: tuple[int, int]
    restart: int
    blocks: npt.NDArray[np.int64]
    codes: npt.NDArray[np.uint16]
    quick: npt.NDArray[np.uint16]
    dc_codes: npt.NDArray[np.uint64]

    @property
    def grid(self) -> tuple[int, int]:
        """The number of (columns, rows) of units."""
        return -(-self.size[0] // self.unit[0]), -(-self.size[1] // self.unit[1])


def excerpt(data: bytes, rect: Rect) -> tuple[bytes, tuple[int, int]] | None:
    """Return a JPEG with the part of ``data`` around ``rect``, and where the rectangle lies in it.

    Parameters
    ----------
    data : bytes
        A whole JPEG, whose header :func:`inspect` has read.
    rect : (int, int, int, int)
        ``(x, y, w, h)`` in pixels as they are stored, inside the picture.

    Returns
    -------
    (bytes, (int, int)) or None
        The excerpt and the position (x, y) in it of the rectangle's first pixel. None if the JPEG has more than one
        scan, is damaged, or has a fault of form that a decoder would warn about.
    """
    found = _segments(data)
    layout = found and _layout(found[0])
    if not found or not layout:
        return None
    (columns, rows), (across, down) = layout.grid, layout.unit
    x, y, w, h = rect
    left, right = _units(x, w, across, columns)
    top, bottom = _units(y, h, down, rows)
    coded = _copy(data, found[1], layout, (left, top, right, bottom))
    if coded is None:
        return None
    width = min(right * across, layout.size[0]) - left * across
    height = min(bottom * down, layout.size[1]) - top * down
    before, after = layout.head
    small = b"".join((before, struct.pack(">HH", height, width), after, coded, b"\xff\xd9"))
    return small, (x - left * across, y - top * down)


def _units(start: int, length: int, side: int, count: int) -> tuple[int, int]:
    """Return the first unit and the one after the last of ``count`` that decide on a line of pixels.

    They are two at least: in a picture of a few pixels the decoder does not interpolate the chroma.
    """
    first, last = max(start - MARGIN, 0) // side, min(-(-(start + length + MARGIN) // side), count)
    return (max(first - 1, 0), min(last + 1, count)) if last - first < 2 else (first, last)


def _copy(data: bytes, at: int, layout: _Layout, window: Rect) -> bytes | None:
    """Return the coded data of the units in ``window`` (left, top, right, bottom); None if any are damaged."""
    count = layout.grid[0] * layout.grid[1]
    restart = layout.restart or count
    ends = np.empty(-(-count // restart), np.int64)
    plain = scratch("unstuffed", (len(data) - at + kernels.PADDING,), np.uint8)
    if not kernels.unstuff(np.frombuffer(data, np.uint8), at, plain, ends):
        return None
    blocks = (window[2] - window[0]) * (window[3] - window[1]) * len(layout.blocks)
    out = scratch("excerpt", (len(plain) + 4 * blocks,), np.uint8)
    tables = layout.codes, layout.quick, layout.dc_codes
    length = kernels.excerpt(plain, ends, restart, layout.blocks, *tables, layout.grid, window, out)
    return None if length == kernels.DAMAGED else out[:length].tobytes().replace(b"\xff", b"\xff\0")


def _segments(data: bytes) -> tuple[bytes, int] | None:
    """Return the segments that decide on the pixels, and where the coded data begin.

    None if there are bytes between segments, or a segment that a sequential JPEG does not have.
    """
    kept, at = [], 2
    for _ in range(MAX_PARTS):
        if at + 4 > len(data) or data[at] != 0xFF:
            return None
        marker, length = data[at + 1], data[at + 2] << 8 | data[at + 3]
        end = at + 2 + length
        if length < 2:
            return None
        if marker in _SOF or marker in (_SOS, _DHT, _DQT, _DRI):
            kept.append(data[at:end])
        elif marker in (_APP0, _APP14):  # they decide on the color space
            if data.startswith((b"JFIF\0", b"Adobe"), at + 4):
                kept.append(data[at:end])
        elif not (_APP0 <= marker <= 0xEF or marker == _COM):
            return None
        at = end
        if marker == _SOS:
            return b"".join(kept), at
    return None


@lru_cache(maxsize=8)
def _layout(segments: bytes) -> _Layout | None:
    """Return what :func:`_segments` says, or None if excerpts of such a JPEG cannot be made."""
    try:
        return _read(segments)
    except (ValueError, LookupError, struct.error):
        return None


def _read(segments: bytes) -> _Layout:
    tables, head, rest = dict(huffman.standard()), b"\xff\xd8", b""
    restart, at, marker, frame = 0, 0, 0, b""
    while marker != _SOS:
        marker, end = segments[at + 1], at + 2 + (segments[at + 2] << 8 | segments[at + 3])
        segment, body = segments[at:end], segments[at + 4 : end]
        at = end
        if marker in _SOF:
            head, rest, frame = head + rest + segment[:5], segment[9:], body
        elif marker == _DHT:
            tables |= huffman.split(body)
        elif marker == _DRI:
            (restart,) = struct.unpack(">H", body)
        elif marker != _SOS:
            rest += segment
    factors = {frame[i]: (frame[i + 1] >> 4, frame[i + 1] & 15) for i in range(6, 6 + 3 * frame[5], 3)}
    count = body[0]
    scan = [(body[i], body[i + 1] >> 4, body[i + 1] & 15) for i in range(1, 1 + 2 * count, 2)]
    repeats = [factors[name][0] * factors[name][1] if count > 1 else 1 for name, _, _ in scan]
    across, down = (max(sides) if count > 1 else 1 for sides in zip(*factors.values(), strict=True))
    _require(len({name for name, _, _ in scan}) == len(factors) == frame[5] == count)
    _require(min(map(min, factors.values())) > 0 and max(map(max, factors.values())) <= 4)
    _require(sum(repeats) <= _MOST_BLOCKS and all(dc <= 3 for _, dc, _ in scan))
    used = sorted({dc for _, dc, _ in scan} | {4 + ac for _, _, ac in scan})
    chosen = [_completed(tables[number]) if number < 4 else tables[number] for number in used]
    blocks = [
        (index, int(number == 0), used.index(dc), used.index(4 + ac))
        for index, ((_, dc, ac), repeat) in enumerate(zip(scan, repeats, strict=True))
        for number in range(repeat)
    ]
    for number, table in zip(used, chosen, strict=True):
        rest += struct.pack(">BBHB", 0xFF, _DHT, 3 + len(table), number % 4 + 16 * (number // 4)) + table
    height, width = struct.unpack_from(">HH", frame, 1)
    codes = np.stack([huffman.lookup(table) for table in chosen])
    return _Layout(
        head=(head, rest + segment),
        size=(width, height),
        unit=(8 * across, 8 * down),
        restart=restart,
        blocks=np.array(blocks, np.int64),
        codes=codes,
        quick=np.stack([_quick(row, number >= 4) for number, row in zip(used, codes, strict=True)]),
        dc_codes=np.stack([_dc_codes(table) for table in chosen]),
    )


def _completed(table: bytes) -> bytes:
    """Return a DC table with a code for every size: the missing ones get codes of 16 bits behind the others."""
    symbols = table[16:]
    missing = bytes(size for size in range(_DC_SIZES) if size not in symbols)
    return table[:15] + bytes([table[15] + len(missing)]) + symbols + missing


def _quick(codes: npt.NDArray[np.uint16], of_ac: bool) -> npt.NDArray[np.uint16]:
    quick = codes[:: 1 << (16 - kernels.BITS)].copy()
    if of_ac:
        kernels.combine(codes, quick)
    else:
        quick[quick >> 8 > kernels.BITS] = 0
    return quick


def _dc_codes(table: bytes) -> npt.NDArray[np.uint64]:
    """Return 32 times the code of each size plus its length, (16,), or 0 where there is none."""
    found, code, at = np.zeros(16, np.uint64), 0, 16
    for length in range(1, 17):
        for symbol in table[at : at + table[length - 1]]:
            if symbol < len(found):
                found[symbol] = code << 5 | length
            code += 1
        at += table[length - 1]
        code <<= 1
    return found


def _require(condition: bool) -> None:
    if not condition:
        raise ValueError("no excerpt")
