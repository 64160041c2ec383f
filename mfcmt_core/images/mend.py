"""Rewrite a JPEG without the harmless faults that decoders warn about.

Cameras and phones write JPEGs with a whole picture in a faulty form: stray bytes before a marker, an invented revision
of JFIF, wrong scan parameters, a vendor's trailer in place of the end. The decoder only warns, and it warns in the same
way if half of the picture is missing; it also reports only its first warning. Therefore the harmless faults are removed
here, and the result must decode without any warning.
"""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt

from ..kernels import coded
from . import huffman
from .header import MAX_PARTS

_MARKER = re.compile(rb"\xff[^\x00\xff]")
_SOI, _EOI, _SOS, _DHT, _DQT, _DRI, _DNL, _COM, _TEM = 0xD8, 0xD9, 0xDA, 0xC4, 0xDB, 0xDD, 0xDC, 0xFE, 0x01
_SOF_PROGRESSIVE = 0xC2
_SOF = (0xC0, 0xC1, _SOF_PROGRESSIVE)
_JFIF = b"\xff\xe0\x00\x10JFIF\0\x01\x01\0\0\x01\0\x01\0\0"
_MOST_BLOCKS = 10
"""Largest number of blocks in a unit of an interleaved scan, by the standard."""


def mend(data: bytes) -> bytes:
    """Return the JPEG with the same Huffman-coded data, but without anything that a decoder would warn about.

    Raises
    ------
    ValueError
        If coded data are missing or damaged, so that no decoder could show the whole picture.

    References
    ----------
    ITU-T Recommendation T.81, annexes B, F and G.
    """
    picture = _Picture(data)
    try:
        picture.read()
    except IndexError:
        raise ValueError("a segment is cut off") from None
    return b"".join([b"\xff\xd8", *picture.parts, b"\xff\xd9"])


class _Component:
    """One color component: its sampling factors, and the coefficients that the scans have given so far."""

    def __init__(self, across: int, down: int) -> None:
        if not (1 <= across <= 4 and 1 <= down <= 4):
            raise ValueError("the sampling factors are invalid")
        self.across, self.down = across, down
        self.missing = np.full(64, 16)  # low bits of each coefficient; 16 before its first scan
        self.nonzero: npt.NDArray[np.uint64] | None = None


class _Picture:
    """Reads the segments of a JPEG. ``parts`` are those of the mended JPEG."""

    def __init__(self, data: bytes) -> None:
        self.parts: list[bytes] = []
        self._data = data
        self._bytes = np.frombuffer(data, np.uint8)
        self._components: dict[int, _Component] = {}
        self._width = self._height = self._restart = 0
        self._progressive = False
        self._tables = np.zeros((8, 1 << 16), np.uint16)  # four for DC, four for AC
        self._set_tables(huffman.standard())

    def read(self) -> None:
        """Read segments and scans to the end, or until the picture is complete."""
        data, at = self._data, 2
        for _ in range(MAX_PARTS):
            found = _MARKER.search(data, at)
            if found is None:
                raise ValueError("the file ends before the picture does")
            marker, at = data[found.end() - 1], found.end()
            if marker == _EOI:
                break
            if marker == _TEM or 0xD0 <= marker <= 0xD7:
                continue
            length = data[at] << 8 | data[at + 1]
            body, segment = data[at + 2 : at + length], data[found.start() : at + length]
            if length < 2 or len(body) != length - 2:
                raise ValueError("a segment is cut off")
            at += length
            if marker == _SOS:
                at = self._scan(body, at)
                if all(not component.missing.any() for component in self._components.values()):
                    return
            elif marker in _SOF:
                self._frame(marker, body)
                self.parts.append(segment)
            elif marker in (_DHT, _DQT, _DRI):
                if marker == _DHT:
                    self._set_tables(huffman.split(body))
                elif marker == _DRI:
                    self._restart = body[0] << 8 | body[1]
                self.parts.append(segment)
            elif 0xE0 <= marker <= 0xEF:
                self._application(marker, body)
            elif marker not in (_COM, _DNL):
                raise ValueError(f"unexpected marker {marker:02x}")
        if not self._components or any(c.missing[0] == 16 for c in self._components.values()):
            raise ValueError("a component has no scan")

    def _application(self, marker: int, body: bytes) -> None:
        """Keep the segments that decide on the color space."""
        if marker == 0xE0 and body.startswith(b"JFIF\0") and len(body) >= 14:
            self.parts.append(_JFIF)
        elif marker == 0xEE and body.startswith(b"Adobe") and len(body) >= 12:
            known = body[11] <= 2
            transform = body[11:12] if known else b"\2" if len(self._components) == 4 else b"\1"
            self.parts.append(b"\xff\xee\x00\x0e" + body[:11] + transform)

    def _frame(self, marker: int, body: bytes) -> None:
        self._progressive = marker == _SOF_PROGRESSIVE
        self._height, self._width = body[1] << 8 | body[2], body[3] << 8 | body[4]
        for at in range(6, 6 + 3 * body[5], 3):
            self._components[body[at]] = _Component(body[at + 1] >> 4, body[at + 1] & 15)
        if len(self._components) != body[5]:
            raise ValueError("two components have the same name")
        if self._progressive:
            self._tables[:] = 0  # progressive images have no standard tables

    def _set_tables(self, tables: dict[int, bytes]) -> None:
        for number, table in tables.items():
            self._tables[number] = huffman.lookup(table)

    def _scan(self, body: bytes, at: int) -> int:
        """Copy one scan, whose coded data begin at ``at``, and return where the next marker begins."""
        names = [body[1 + 2 * i] for i in range(body[0])]
        components = [self._components[name] for name in names if name in self._components]
        if not components or len(components) != body[0] or len(set(names)) != len(names):
            raise ValueError("a scan has invalid components")
        first, last, bits = (body[1 + 2 * body[0] + i] for i in range(3)) if self._progressive else (0, 63, 0)
        high, low = bits >> 4, bits & 15
        if self._progressive:
            if first > last or last > 63 or (first == 0) != (last == 0) or (first and len(components) > 1):
                raise ValueError("a scan has invalid coefficients")
            kind = [coded.DC_FIRST, coded.DC_REFINED, coded.AC_FIRST, coded.AC_REFINED][2 * (first > 0) + (high > 0)]
        else:
            kind = coded.SEQUENTIAL
        blocks, count = self._units(components, [body[2 + 2 * i] for i in range(body[0])])
        nonzero = np.zeros(1, np.uint64)
        if kind in (coded.AC_FIRST, coded.AC_REFINED):
            if components[0].nonzero is None:
                components[0].nonzero = np.zeros(count, np.uint64)
            nonzero = components[0].nonzero
        ends = np.zeros((-(-count // self._restart) if self._restart else 1, 2), np.int64)
        tables, restart = self._tables.ravel(), self._restart
        if coded.walk(self._bytes, at, kind, blocks, tables, first, last, restart, nonzero, count, ends) < 0:
            raise ValueError("coded data are missing or damaged")
        for component in components:
            component.missing[first : last + 1] = low
        self.parts.append(b"\xff\xda" + (len(body) + 2).to_bytes(2, "big") + body[: 1 + 2 * body[0]])
        self.parts.append(bytes([first, last, bits]) + body[4 + 2 * body[0] :])
        for gap in np.flatnonzero(ends[:-1, 0] != ends[:-1, 1]):
            self.parts.append(self._data[at : ends[gap, 0]])
            at = int(ends[gap, 1])
        self.parts.append(self._data[at : ends[-1, 0]])
        return int(ends[-1, 1])

    def _units(self, components: list[_Component], slots: list[int]) -> tuple[npt.NDArray[np.int64], int]:
        """Return the tables of every block in a unit of a scan, (blocks, 2) int64, and the number of units."""
        across = max(c.across for c in self._components.values())
        down = max(c.down for c in self._components.values())
        if len(components) == 1:  # not interleaved: each block is a unit
            columns = -(-self._width * components[0].across // across)
            rows = -(-self._height * components[0].down // down)
            count, repeats = -(-columns // 8) * -(-rows // 8), [1]
        else:
            count = -(-self._width // (8 * across)) * -(-self._height // (8 * down))
            repeats = [c.across * c.down for c in components]
        if sum(repeats) > _MOST_BLOCKS or any((slot >> 4) > 3 or (slot & 15) > 3 for slot in slots):
            raise ValueError("a scan is invalid")
        blocks = [(s >> 4, 4 + (s & 15)) for s, n in zip(slots, repeats, strict=True) for _ in range(n)]
        return np.array(blocks, np.int64) << 16, count
