"""How far the Huffman-coded data of a JPEG go (ITU-T T.81, annexes F and G), without making pixels of them."""

from __future__ import annotations

import numpy as np

from ._jit import kernel

SEQUENTIAL, DC_FIRST, DC_REFINED, AC_FIRST, AC_REFINED = range(5)
"""What a scan codes."""

DAMAGED = -1


@kernel
def fill(data, state):  # type: ignore[no-untyped-def]
    """Top up ``state`` to at least 25 bits, as far as bytes come before the next marker.

    ``state`` (3,) int64 is the position in ``data`` (N,) uint8, the bits that were read and not yet used, and how
    many these are.
    """
    while state[2] <= 24:
        at = state[0]
        if at >= data.size:
            return
        value = np.int64(data[at])
        at += 1
        if value == 0xFF:
            while at < data.size and data[at] == 0xFF:
                at += 1
            if at >= data.size or data[at] != 0:
                return
            at += 1
        state[0] = at
        state[1] = (state[1] << 8 | value) & 0xFFFFFFFF
        state[2] += 8


@kernel
def take(data, state, count):  # type: ignore[no-untyped-def]
    """The next ``count`` bits (at most 16) as an int64; -1 where there are not so many."""
    if state[2] < count:
        fill(data, state)
        if state[2] < count:
            return np.int64(-1)
    state[2] -= count
    return state[1] >> state[2] & ((1 << count) - 1)


@kernel
def symbol(data, state, tables, table):  # type: ignore[no-untyped-def]
    """The next Huffman symbol as an int64; -1 where no code fits or the bits run out.

    ``tables`` (T * 65536,) uint16 gives, from ``table`` on, for the next 16 bits the length of their first code, times
    256, and its symbol.
    """
    if state[2] < 16:
        fill(data, state)
    if state[2] >= 16:
        entry = np.int64(tables[table + (state[1] >> (state[2] - 16) & 0xFFFF)])
    else:
        entry = np.int64(tables[table + (state[1] << (16 - state[2]) & 0xFFFF)])
    length = entry >> 8
    if length == 0 or length > state[2]:
        return np.int64(-1)
    state[2] -= length
    return entry & 0xFF


@kernel
def skip_block(data, state, tables, table):  # type: ignore[no-untyped-def]
    """Read the AC coefficients of a block of a sequential scan; False where the data are damaged."""
    k = 1
    while k < 64:
        coded = symbol(data, state, tables, table)
        if coded < 0:
            return False
        size = coded & 15
        if size:
            if take(data, state, size) < 0:
                return False
        elif coded != 0xF0:
            return True
        k += (coded >> 4) + 1
    return True


@kernel
def skip_first(data, state, tables, table, first, last, run, nonzero):  # type: ignore[no-untyped-def]
    """The same of a first progressive scan: the run of empty blocks after it and the coefficients that are not zero,
    as a bit each. A negative run means damage."""
    k = first
    while k <= last:
        coded = symbol(data, state, tables, table)
        if coded < 0:
            return np.int64(-1), nonzero
        zeros, size = coded >> 4, coded & 15
        if size:
            k += zeros
            if take(data, state, size) < 0:
                return np.int64(-1), nonzero
            if k < 64:
                nonzero |= np.uint64(1) << np.uint64(k)
        elif zeros == 15:
            k += 15
        else:
            more = take(data, state, zeros)
            return (np.int64(-1) if more < 0 else (1 << zeros) + more - 1), nonzero
        k += 1
    return run, nonzero


@kernel
def skip_refined(data, state, tables, table, first, last, run, nonzero):  # type: ignore[no-untyped-def]
    """The same of a progressive scan that adds a bit to what earlier ones gave."""
    k = first
    one = np.uint64(1)
    if run == 0:
        while k <= last:
            coded = symbol(data, state, tables, table)
            if coded < 0:
                return np.int64(-1), nonzero
            zeros, size = coded >> 4, coded & 15
            if size > 1 or (size == 1 and take(data, state, 1) < 0):
                return np.int64(-1), nonzero
            if size == 0 and zeros < 15:
                more = take(data, state, zeros)
                if more < 0:
                    return more, nonzero
                run = (1 << zeros) + more
                break
            while k <= last:
                if nonzero >> np.uint64(k) & one:
                    if take(data, state, 1) < 0:
                        return np.int64(-1), nonzero
                else:
                    if zeros == 0:
                        break
                    zeros -= 1
                k += 1
            if size and k < 64:
                nonzero |= one << np.uint64(k)
            k += 1
    if run > 0:
        while k <= last:
            if nonzero >> np.uint64(k) & one and take(data, state, 1) < 0:
                return np.int64(-1), nonzero
            k += 1
        run -= 1
    return run, nonzero


@kernel
def walk(data, state, kind, blocks, tables, first, last, restart, nonzero, count, ends):  # type: ignore[no-untyped-def]
    """Read the ``count`` units of a scan from ``state`` on; the number of its intervals, or DAMAGED.

    ``blocks`` (B, 2) int64 says where in ``tables`` the DC and the AC table of every block of a unit begin.
    ``first`` and ``last`` are the scan's coefficients, ``restart`` its units between restart markers, or 0.
    ``nonzero`` (count,) uint64 has the coefficients of each block that are not zero, for the AC scans of a progressive
    image. ``ends`` (I, 2) int64 takes for each interval where its data end and where the marker after that begins.
    """
    intervals, run = 0, np.int64(0)
    for unit in range(count):
        for b in range(blocks.shape[0]):
            if kind <= DC_FIRST:
                size = symbol(data, state, tables, blocks[b, 0])
                if size < 0 or size > 15 or take(data, state, size) < 0:
                    return DAMAGED
                if kind == SEQUENTIAL and not skip_block(data, state, tables, blocks[b, 1]):
                    return DAMAGED
            elif kind == DC_REFINED:
                if take(data, state, 1) < 0:
                    return DAMAGED
            elif kind == AC_FIRST:
                if run > 0:
                    run -= 1
                else:
                    table = blocks[b, 1]
                    run, nonzero[unit] = skip_first(data, state, tables, table, first, last, run, nonzero[unit])
            else:
                table = blocks[b, 1]
                run, nonzero[unit] = skip_refined(data, state, tables, table, first, last, run, nonzero[unit])
            if run < 0:
                return DAMAGED
        done = unit + 1 == count
        if not done and (restart == 0 or (unit + 1) % restart):
            continue
        end = state[0]
        for _ in range(state[2] >> 3):  # bytes that were read ahead
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
        state[0], state[1], state[2] = marker + 2, 0, 0
        run = np.int64(0)
    return intervals
