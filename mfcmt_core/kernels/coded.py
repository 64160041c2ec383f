"""Walk through the Huffman-coded data of a JPEG without decoding pixels (ITU-T T.81, annexes F and G).

A position is three int64: ``at`` is the next byte of ``data`` (N,) uint8, ``bits`` are the bits that were read but not
used, and ``have`` is their number, which is negative after damage. ``tables`` (T * 65536,) uint16 holds one table after
another. An entry belongs to the next 16 bits: 256 times the length of the first code in them plus its symbol, or 0.
"""

from __future__ import annotations

import numpy as np

from ._jit import kernel

SEQUENTIAL, DC_FIRST, DC_REFINED, AC_FIRST, AC_REFINED = range(5)
"""Kinds of scans."""

DAMAGED = -1
_MASK = (1 << 56) - 1


@kernel
def fill(data, at, bits, have):  # type: ignore[no-untyped-def]
    """Return the same position with more than 48 bits in ``bits``, or as many as there are before the next marker."""
    while have <= 48 and at < data.size:
        value, after = np.int64(data[at]), at + 1
        if value == 0xFF:
            while after < data.size and data[after] == 0xFF:
                after += 1
            if after == data.size or data[after] != 0:
                break
            after += 1
        at, bits, have = after, (bits << 8 | value) & _MASK, have + 8
    return at, bits, have


@kernel
def peek(tables, table, bits, have):  # type: ignore[no-untyped-def]
    """Return the entry of the next code in the table at ``table``, or 0 if no code fits or bits are missing."""
    ahead = bits >> (have - 16) if have >= 16 else bits << (16 - have)
    entry = np.int64(tables[table + (ahead & 0xFFFF)])
    return entry if entry >> 8 <= have else np.int64(0)


@kernel
def skip_dc(data, at, bits, have, tables, table):  # type: ignore[no-untyped-def]
    """Return the position after the DC coefficient of a block."""
    if have < 32:
        at, bits, have = fill(data, at, bits, have)
    entry = peek(tables, table, bits, have)
    have -= (entry >> 8) + (entry & 15)
    return at, bits, (have if entry and not entry & 0xF0 else np.int64(-1))


@kernel
def skip_ac(data, at, bits, have, tables, table):  # type: ignore[no-untyped-def]
    """Return the position after the AC coefficients of a block of a sequential scan."""
    k = 1
    while k < 64 and have >= 0:
        if have < 32:
            at, bits, have = fill(data, at, bits, have)
        entry = peek(tables, table, bits, have)
        if entry == 0:
            return at, bits, np.int64(-1)
        have -= (entry >> 8) + (entry & 15)
        if entry & 15 == 0 and entry & 0xF0 != 0xF0:
            break
        k += (entry >> 4 & 15) + 1
    return at, bits, have


@kernel
def skip_first(data, at, bits, have, tables, table, first, last, nonzero):  # type: ignore[no-untyped-def]
    """Skip a block in the first AC scan of a progressive image.

    Returns the position after it, the number of empty blocks that follow, and ``nonzero`` with the bits of the
    coefficients that are not zero.
    """
    k = first
    while k <= last and have >= 0:
        if have < 32:
            at, bits, have = fill(data, at, bits, have)
        entry = peek(tables, table, bits, have)
        if entry == 0:
            return at, bits, np.int64(-1), np.int64(0), nonzero
        have -= entry >> 8
        zeros, size = entry >> 4 & 15, entry & 15
        if size == 0 and zeros < 15:
            have -= zeros
            run = (1 << zeros) - 1 + (bits >> max(have, 0) & ((1 << zeros) - 1))
            return at, bits, have, run, nonzero
        have -= size
        k += zeros
        if size:
            nonzero |= np.uint64(1) << np.uint64(min(k, 63))
        k += 1
    return at, bits, have, np.int64(0), nonzero


@kernel
def skip_refined(data, at, bits, have, tables, table, first, last, run, nonzero):  # type: ignore[no-untyped-def]
    """Skip a block in an AC scan that refines earlier ones. ``run`` counts the empty blocks left; returns as above."""
    k, one = first, np.uint64(1)
    while k <= last:
        if have < 32:
            at, bits, have = fill(data, at, bits, have)
        zeros, size = np.int64(64), np.int64(0)
        if run == 0:
            entry = peek(tables, table, bits, have)
            have -= entry >> 8
            zeros, size = entry >> 4 & 15, entry & 15
            if size == 0 and zeros < 15:
                have -= zeros
                run = (1 << zeros) + (bits >> max(have, 0) & ((1 << zeros) - 1))
                zeros = np.int64(64)
            have -= size
            if entry == 0 or size > 1 or have < 0:
                return at, bits, np.int64(-1), np.int64(0), nonzero
        while k <= last:
            if nonzero >> np.uint64(k) & one:  # a nonzero coefficient has one more bit here
                if have == 0:
                    at, bits, have = fill(data, at, bits, have)
                have -= 1
                if have < 0:
                    return at, bits, have, np.int64(0), nonzero
            elif zeros == 0:
                break
            else:
                zeros -= 1
            k += 1
        if size:
            nonzero |= one << np.uint64(min(k, 63))
        k += 1
    return at, bits, have, max(run - 1, 0), nonzero


@kernel
def walk(data, at, kind, blocks, tables, first, last, restart, nonzero, count, ends):  # type: ignore[no-untyped-def]
    """Read the ``count`` units of a scan whose data begin at ``at``. Return the number of intervals, or DAMAGED.

    ``blocks`` (B, 2) int64 holds where the DC and the AC table of each block of a unit begin. ``first`` and ``last``
    are the scan's coefficients, ``restart`` is the number of units between restart markers, or 0. ``nonzero``
    (count,) uint64 has a bit for each coefficient of a block that is not zero, for the AC scans of a progressive
    image. ``ends`` (I, 2) int64 receives for each interval where its data end and where the next marker begins.
    """
    intervals, run, bits, have = 0, np.int64(0), np.int64(0), np.int64(0)
    for unit in range(count):
        for b in range(blocks.shape[0]):
            dc, ac = blocks[b, 0], blocks[b, 1]
            if kind <= DC_FIRST:
                at, bits, have = skip_dc(data, at, bits, have, tables, dc)
                if kind == SEQUENTIAL and have >= 0:
                    at, bits, have = skip_ac(data, at, bits, have, tables, ac)
            elif kind == DC_REFINED:
                if have == 0:
                    at, bits, have = fill(data, at, bits, have)
                have -= 1
            elif kind == AC_REFINED:
                at, bits, have, run, nonzero[unit] = skip_refined(
                    data, at, bits, have, tables, ac, first, last, run, nonzero[unit]
                )
            elif run > 0:
                run -= 1
            else:
                at, bits, have, run, nonzero[unit] = skip_first(
                    data, at, bits, have, tables, ac, first, last, nonzero[unit]
                )
            if have < 0:
                return DAMAGED
        done = unit + 1 == count
        if not done and (restart == 0 or (unit + 1) % restart):
            continue
        end = at
        for _ in range(have >> 3):  # go back over the bytes that were read ahead
            stuffed = data[end - 1] == 0 and data[end - 2] == 0xFF
            end -= 2 if stuffed else 1
            while stuffed and data[end - 1] == 0xFF:
                end -= 1
        marker = end
        while marker + 1 < data.size and (data[marker] != 0xFF or data[marker + 1] == 0 or data[marker + 1] == 0xFF):
            marker += 1
        ends[intervals, 0], ends[intervals, 1] = end, marker
        if not done and (marker + 1 >= data.size or data[marker + 1] != 0xD0 + intervals % 8):
            return DAMAGED
        intervals += 1
        at, bits, have, run = marker + 2, np.int64(0), np.int64(0), np.int64(0)
    return intervals
