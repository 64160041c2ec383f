"""Huffman tables of JPEGs in the form that the kernels ``coded`` and ``excerpt`` look codes up in."""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np
import numpy.typing as npt
import simplejpeg

_SOS, _DHT = 0xDA, 0xC4
_MOST_SYMBOLS = 256


@lru_cache(maxsize=16)
def lookup(table: bytes) -> npt.NDArray[np.uint16]:
    """Expand a Huffman table (the number of codes of each length, then their symbols) to the form of ``coded``."""
    lengths = np.repeat(np.arange(1, 17), np.frombuffer(table[:16], np.uint8))
    spans = 1 << (16 - lengths)
    if spans.sum() > 1 << 16:
        raise ValueError("a Huffman table is invalid")
    entries = lengths << 8 | np.frombuffer(table[16:], np.uint8)
    found = np.zeros(1 << 16, np.uint16)
    found[: spans.sum()] = np.repeat(entries.astype(np.uint16), spans)
    return found


def split(body: bytes) -> dict[int, bytes]:
    """Return the tables of a DHT segment by their number: 0 to 3 are those of DC, 4 to 7 those of AC.

    Raises
    ------
    ValueError
        If a table is cut off, has another number, or too many symbols.
    """
    tables, at = {}, 0
    while at < len(body):
        end = at + 17 + sum(body[at + 1 : at + 17])
        kind, slot = body[at] >> 4, body[at] & 15
        if kind > 1 or slot > 3 or end > min(len(body), at + 17 + _MOST_SYMBOLS):
            raise ValueError("a Huffman table is invalid")
        tables[4 * kind + slot] = body[at + 1 : end]
        at = end
    return tables


@cache
def standard() -> dict[int, bytes]:
    """Return the tables of a sequential JPEG without its own, as in a camera's video. An encoder supplies them."""
    data = simplejpeg.encode_jpeg(np.zeros((8, 8, 3), np.uint8))
    tables: dict[int, bytes] = {}
    at = 2
    while data[at + 1] != _SOS:
        length = data[at + 2] << 8 | data[at + 3]
        if data[at + 1] == _DHT:
            tables |= split(data[at + 4 : at + 2 + length])
        at += 2 + length
    return tables
