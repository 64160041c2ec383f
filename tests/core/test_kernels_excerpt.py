"""The kernels that copy a part of a JPEG's coded data, one by one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mfcmt_core.images import huffman
from mfcmt_core.kernels import excerpt as kernels

NONE = np.uint64(0)


def unstuffed(data, intervals=1, at=0):
    """Return the bytes that ``unstuff`` writes and where its intervals end, or None if it finds damage."""
    out, ends = np.full(len(data) + kernels.PADDING, 7, np.uint8), np.zeros(intervals, np.int64)
    if not kernels.unstuff(np.frombuffer(data, np.uint8), at, out, ends):
        return None
    assert not out[ends[-1] : ends[-1] + kernels.PADDING].any()
    return out[: ends[-1]].tobytes(), ends.tolist()


@pytest.mark.parametrize("length", [0, 1, 31, 32, 33, 100])
def test_stuffing_is_removed(length):
    data = bytes(range(length)) + b"\xff\0\xff\0" + bytes(range(length))
    plain = data.replace(b"\xff\0", b"\xff")
    assert unstuffed(data + b"\xff\xd9 and more") == (plain, [len(plain)])
    assert unstuffed(b"\xff\xff" + data + b"\xff\xd9", at=2) == (plain, [len(plain)])


def test_restart_markers_are_removed():
    data = b"".join(b"%d\xff" % number + bytes([0xD0 + number % 8]) for number in range(10)) + b"x\xff\xd9"
    assert unstuffed(data, 11) == (b"0123456789x", list(range(1, 12)))
    assert unstuffed(data, 10) is None
    assert unstuffed(data, 12) is None
    assert unstuffed(data.replace(b"\xd3", b"\xd4"), 11) is None


@pytest.mark.parametrize("end", [b"", b"\xff", b"\xff\xff\xd9", b"\xff\xda", b"\xff\xd0"])
def test_data_without_the_end_of_the_image_are_damaged(end):
    assert unstuffed(bytes(40) + end) is None


def steps(codes, bits, used=0, count=0):
    """Return the codes and the coefficients that begin in ``bits``, one code after the other, as ``combine`` does."""
    while used < len(bits):
        entry = int(codes[int(bits[used:].ljust(16, "0")[:16], 2)])
        length, zeros, size = entry >> 8, entry >> 4 & 15, entry & 15
        if entry == 0 or used + length > len(bits) or count + zeros + 1 > 63:
            break
        used += length + size
        if size == 0 and zeros < 15:
            return used, count + 128
        count += zeros + 1
    return (used, count) if used else (0, 256)


def test_an_entry_says_what_all_codes_in_its_bits_do():
    for number in (4, 5):
        codes = huffman.lookup(huffman.standard()[number])
        quick = np.empty(1 << kernels.BITS, np.uint16)
        kernels.combine(codes, quick)
        for index in range(0, len(quick), 7):
            used, count = steps(codes, format(index, f"0{kernels.BITS}b"))
            assert (quick[index] & 31, quick[index] >> 5) == (used, count)


@given(st.lists(st.tuples(st.integers(0, 2**64 - 1), st.integers(1, 64)), max_size=20))
def test_bits_are_put_one_after_the_other(values):
    out = np.zeros(8 * len(values) + 8, np.uint8)
    written = pending = filled = NONE
    text = ""
    for value, count in values:
        bits = format(value, "064b")[:count]
        top = np.uint64(int(bits.ljust(64, "0"), 2))
        written, pending, filled = (
            np.uint64(v) for v in kernels.put(out, written, pending, filled, top, np.uint64(count))
        )
        text += bits
    got = "".join(format(byte, "08b") for byte in out[: int(written)]) + format(int(pending), "064b")[: int(filled)]
    assert got == text


@given(st.binary(min_size=1, max_size=40), st.data())
def test_bits_are_copied_from_any_place(data, draw):
    first = draw.draw(st.integers(0, 8 * len(data)))
    last = draw.draw(st.integers(first, 8 * len(data)))
    source = np.frombuffer(data + bytes(16), np.uint8)
    out = np.zeros(len(data) + 16, np.uint8)
    written, pending, filled = kernels.put_bits(out, NONE, NONE, NONE, source, np.uint64(first), np.uint64(last))
    text = "".join(format(byte, "08b") for byte in data)
    got = "".join(format(byte, "08b") for byte in out[: int(written)]) + format(int(pending), "064b")[: int(filled)]
    assert got == text[first:last]


@pytest.mark.parametrize("difference", [0, 1, -1, 5, -5, 1023, -1024, 2047, -2047, 2048, 1 << 40])
def test_a_difference_is_put_with_the_code_of_its_size(difference):
    out, codes = np.zeros(8, np.uint8), np.array([(size + 3) << 5 | 5 for size in range(12)] + [0] * 4, np.uint64)
    _, pending, filled = kernels.put_dc(out, NONE, NONE, NONE, np.int64(difference), codes)
    size = abs(difference).bit_length()
    value = difference if difference >= 0 else difference + (1 << size) - 1
    if size > 11:
        assert filled == 64
    else:
        expected = format(size + 3, "05b") + (format(value, f"0{size}b") if size else "")
        assert format(int(pending), "064b")[: int(filled)] == expected
