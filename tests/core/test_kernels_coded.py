"""The walk through a JPEG's coded data finds their end, and damage exactly where libjpeg finds it."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest
import simplejpeg
from hypothesis import given
from hypothesis import strategies as st

from mfcmt_core.images.huffman import lookup
from mfcmt_core.images.mend import mend
from mfcmt_core.kernels import coded

from . import jpegs

START = (np.int64(0), np.int64(0), np.int64(0))
"""The place before the first bit."""


def data_of(*values):
    return np.frombuffer(bytes(values), np.uint8)


def table(*symbols):
    """Return a table with the codes 0, 10, 110 and 1110 for four symbols."""
    return lookup(bytes([1, 1, 1, 1]) + bytes(12) + bytes(symbols))


def test_fill_stops_at_a_marker_and_undoes_stuffing():
    data = data_of(0x12, 0xFF, 0x00, 0xFF, 0xFF, 0x00, 0xFF, 0xD9, 0x34)
    assert coded.fill(data, *START) == (6, 0x12FFFF, 24)
    assert coded.fill(data, 6, 0x12FFFF, 24) == (6, 0x12FFFF, 24)


def test_fill_stops_at_the_end():
    for tail in ((), (0xFF,), (0xFF, 0xFF)):
        assert coded.fill(data_of(0x12, *tail), *START) == (1, 0x12, 8)


def test_peek_returns_the_next_code():
    codes = table(7, 8, 9, 10)
    assert coded.peek(codes, 0, 0b0_10_110_11, 8) == 1 << 8 | 7
    assert coded.peek(codes, 0, 0b0_10_110_11, 7) == 2 << 8 | 8
    assert coded.peek(codes, 0, 0b0_10_110_11, 2) == 0  # one bit is missing
    assert coded.peek(codes, 0, 0b1111 << 20, 24) == 0  # no such code
    assert coded.peek(np.concatenate([codes, table(1, 2, 3, 4)]), 1 << 16, 0b110, 3) == 3 << 8 | 3


def test_skip_dc():
    tables = table(0x00, 0x01, 0x05, 0x10)
    assert coded.skip_dc(data_of(0b10_1_10000), *START, tables, 0)[2] == 8 - 3
    assert coded.skip_dc(data_of(0b110_11111), *START, tables, 0)[2] == 0
    for damaged in (0b110_1111, 0b1110_0000, 0b11111111):  # cut, no size, no code
        data = data_of(damaged) if damaged > 0x7F else data_of()
        assert coded.skip_dc(data, *START, tables, 0)[2] < 0


def test_skip_ac():
    tables = table(0x00, 0xF0, 0x02, 0x31)  # end, sixteen zeros, a value of two bits, one of one bit after three zeros
    assert coded.skip_ac(data_of(0b10_110_11_0, 0xAA), *START, tables, 0)[2] == 8
    assert coded.skip_ac(data_of(0b110_11_110), *START, tables, 0)[2] < 0
    assert coded.skip_ac(data_of(0xFF, 0, 0xFF, 0), *START, tables, 0)[2] < 0


def test_skip_first():
    tables = table(0x00, 0x20, 0x02, 0x31)  # end, a run of two bits, a value, a value after three zeros
    data, none = data_of(0b110_11_111, 0b0_1_10_11_00), np.uint64(0)
    *place, run, nonzero = coded.skip_first(data, *START, tables, 0, 1, 63, none)
    assert (run, nonzero) == (4 + 3 - 1, 1 << 1 | 1 << 5)
    assert coded.skip_first(data, *place, tables, 0, 1, 63, none)[2:] == (1, 0, 0)
    for damaged in (0b1111_1111, 0b10_1, 0b110_1):
        cut = data_of(damaged) if damaged > 0x7F else data_of()
        assert coded.skip_first(cut, *START, tables, 0, 1, 63, none)[2] < 0


def test_skip_refined():
    tables = table(0x00, 0x11, 0xF0, 0x02)  # end, a new value after one zero, sixteen zeros, what cannot be
    before, none = np.uint64(1 << 2 | 1 << 9), np.int64(0)
    # a new one and its sign, on the way to it the bit of what is at 2; the end, and the bit of what is at 9
    data = data_of(0b10_1_1_0_1_00)
    assert coded.skip_refined(data, *START, tables, 0, 1, 63, none, before)[2:] == (2, 0, before | 1 << 3)
    assert coded.skip_refined(data_of(0b11_000000), *START, tables, 0, 1, 63, np.int64(5), before)[2:] == (6, 4, before)
    for damaged in (0b1110_0000, 0b1111_1111):
        assert coded.skip_refined(data_of(damaged), *START, tables, 0, 1, 63, none, before)[2] < 0
    assert coded.skip_refined(data_of(), *START, tables, 0, 1, 63, np.int64(5), before)[2] < 0


@pytest.mark.parametrize("restart", [0, 2])
def test_walk_says_where_each_interval_ends(restart):
    gray = jpegs.picture()[:64, :40, 0]
    data = jpegs.written(gray, [(1, 1)], restart=restart)
    at, tables = jpegs.segments(data)[1], np.zeros((2, 1 << 16), np.uint16)
    raw, _ = jpegs.standard_tables()
    for found in re.finditer(rb"\xff\xc4", raw):
        body = raw[found.end() + 2 : found.start() + 2 + int.from_bytes(raw[found.end() : found.end() + 2], "big")]
        if body[0] in (0x00, 0x10):
            tables[body[0] >> 4] = lookup(body[1:])
    stray = jpegs.before_restarts(data, b"\1\2\3")
    ends = np.zeros((20 if restart else 1, 2), np.int64)

    def walk(data):
        blocks, nonzero = np.array([[0, 1 << 16]]), np.zeros(1, np.uint64)
        return coded.walk(
            np.frombuffer(data, np.uint8), at, 0, blocks, tables.ravel(), 0, 63, restart, nonzero, 40, ends
        )

    assert walk(data) == len(ends)
    assert ends[:, 0].tolist() == ends[:, 1].tolist() == [*jpegs.restarts(data), len(data) - 2]
    assert walk(stray) == len(ends)
    assert ends[:, 1].tolist() == [*jpegs.restarts(stray), len(stray) - 2]
    assert (ends[:-1, 1] - ends[:-1, 0] == 3).all()
    for cut in range(at, len(data) - 2, 17):
        assert walk(data[:cut]) == coded.DAMAGED


SAMPLES = {
    "sequential": jpegs.plain(),
    "grey": jpegs.encode(jpegs.picture()[:, :, 0]),
    "restarts": jpegs.with_restarts(5),
    "optimised": jpegs.plain(cv2.IMWRITE_JPEG_OPTIMIZE, 1),
    "progressive": jpegs.progressive(),
    "progressive with restarts": jpegs.with_restarts(7, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "progressive grey": jpegs.encode(jpegs.picture()[:, :, 0], cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
}


def strictly(data):
    """Return libjpeg's picture, or its first warning."""
    try:
        return simplejpeg.decode_jpeg(data, "BGR"), ""
    except ValueError as refused:
        return None, str(refused)


@pytest.mark.parametrize("data", SAMPLES.values(), ids=SAMPLES)
def test_a_faultless_picture_is_not_changed(data):
    assert np.array_equal(strictly(mend(data))[0], strictly(data)[0])


@given(st.sampled_from(sorted(SAMPLES)), st.integers(0, 10**6), st.integers(1, 255))
def test_a_jpeg_is_damaged_exactly_if_libjpeg_warns(name, place, change):
    """Change one byte of the coded data without making or losing a marker."""
    data = bytearray(SAMPLES[name])
    at = jpegs.segments(SAMPLES[name])[1]
    at += place % (len(data) - 2 - at)
    if {data[at], data[at - 1], data[at] ^ change} & {0xFF} or not coded_at(SAMPLES[name], at):
        return
    data[at] ^= change
    expected, warning = strictly(bytes(data))
    try:
        mended, _ = strictly(mend(bytes(data)))
    except ValueError:
        mended = None
    if expected is not None:
        # libjpeg-turbo passes over a code that does not exist where it is in a hurry
        assert np.array_equal(mended, expected) or (mended is None and "progressive" not in name)
    elif mended is not None:  # the picture took fewer bits than it should: what is left is stray
        assert "extraneous bytes before marker" in warning


def coded_at(data, place):
    """Return True if the byte belongs to coded data, and not to a table or header between two scans."""
    inside = False
    at = 2
    while at <= place:
        found = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]").search(data, at)
        if found.start() > place:
            return inside
        at = found.end() + int.from_bytes(data[found.end() : found.end() + 2], "big")
        inside = data[found.end() - 1] == 0xDA
    return False
