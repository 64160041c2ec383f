"""Copy some units of a sequential JPEG's coded data, and check all others (ITU-T T.81, annex F).

Coded data are read from bytes without stuffing, which :func:`unstuff` writes. ``bits`` (uint64) holds the next bits,
the first one highest, of which ``have`` are known; ``at`` is the byte that follows them.
"""

from __future__ import annotations

import numpy as np

from ._jit import kernel

BITS = 12
"""Bits by which the next codes are looked up."""
PADDING = 512
"""Zeros after the unstuffed bytes: more than a damaged block can be read beyond them."""
DAMAGED = -1
_END, _MISSING = 128, 256


@kernel
def unstuff(data, at, out, ends):  # type: ignore[no-untyped-def]
    """Write the coded data from ``at`` on without stuffing and restart markers. Return False if they are damaged.

    ``ends`` (intervals,) int64 receives where each interval ends in ``out``, which has room for all of ``data`` and
    its padding. The restart markers must be in order, and the last interval must end at the end of the image.
    """
    block, one, marked = np.uint64(32), np.uint64(1), np.uint8(0xFF)
    size, place, count, interval = np.uint64(data.size), np.uint64(at), np.uint64(0), 0
    while True:
        while place + block <= size:
            found = False
            for i in range(block):
                value = data[place + i]
                out[count + i] = value
                found |= value == marked
            if found:
                break
            place += block
            count += block
        while place < size and data[place] != marked:
            out[count] = data[place]
            place += one
            count += one
        if place + one >= size:
            return False
        marker = data[place + one]
        place += np.uint64(2)
        if marker == 0:
            out[count] = marked
            count += one
            continue
        ends[interval] = count
        interval += 1
        if interval == ends.size or marker != 0xD0 + (interval - 1) % 8:
            for i in range(np.uint64(PADDING)):
                out[count + i] = 0
            return interval == ends.size and marker == 0xD9


@kernel
def combine(codes, out):  # type: ignore[no-untyped-def]
    """Write to ``out`` (2^BITS,) uint16 what all codes of AC coefficients in the next ``BITS`` bits do together.

    ``codes`` (65536,) uint16 is a table as in :mod:`.coded`. An entry has the bits of the codes and their values in
    the lowest 5 bits, and above these the number of coefficients, with 128 if the block ends, or 256 if there is no
    whole code in these bits.
    """
    for index in range(out.size):
        used, count, end = np.int64(0), np.int64(0), 0
        while used < BITS and not end:
            entry = np.int64(codes[index << (16 - BITS) + used & 0xFFFF])
            length, zeros, size = entry >> 8, entry >> 4 & 15, entry & 15
            if entry == 0 or used + length > BITS or count + zeros + 1 > 63:
                break
            used += length + size
            if size == 0 and zeros < 15:
                end = _END
            else:
                count += zeros + 1
        out[index] = (count + end if used else _MISSING) << 5 | used


@kernel
def word(data, at):  # type: ignore[no-untyped-def]
    """Return the eight bytes from ``at`` on as one number, the first of them highest."""
    a = np.uint64(data[at]) << np.uint64(56) | np.uint64(data[at + np.uint64(1)]) << np.uint64(48)
    b = np.uint64(data[at + np.uint64(2)]) << np.uint64(40) | np.uint64(data[at + np.uint64(3)]) << np.uint64(32)
    c = np.uint64(data[at + np.uint64(4)]) << np.uint64(24) | np.uint64(data[at + np.uint64(5)]) << np.uint64(16)
    d = np.uint64(data[at + np.uint64(6)]) << np.uint64(8) | np.uint64(data[at + np.uint64(7)])
    return (a | b) | (c | d)


@kernel
def put(out, written, pending, filled, value, count):  # type: ignore[no-untyped-def]
    """Append the ``count`` highest bits of ``value``, whose others are 0, to ``pending``, which holds ``filled`` bits.

    Eight bytes go to ``out`` when they are full. Returns ``written, pending, filled``.
    """
    pending |= value >> filled
    filled += count
    if filled >= np.uint64(64):
        for i in range(np.uint64(8)):
            out[written + i] = np.uint8(pending >> (np.uint64(56) - np.uint64(8) * i))
        written += np.uint64(8)
        filled -= np.uint64(64)
        pending = value << (count - filled) if filled else np.uint64(0)
    return written, pending, filled


@kernel
def put_dc(out, written, pending, filled, difference, codes):  # type: ignore[no-untyped-def]
    """Append a difference of DC coefficients. Returns as above; ``filled`` is 64 if there is no code for it.

    ``codes`` (16,) uint64 holds 32 times the code of each size plus its length, or 0.
    """
    size, most = np.uint64(0), abs(difference)
    while most >> np.int64(size):
        size += np.uint64(1)
    entry = codes[size] if size < 16 else np.uint64(0)
    if entry == 0:
        return written, pending, np.uint64(64)
    value = np.uint64(difference if difference >= 0 else difference + (np.int64(1) << np.int64(size)) - 1)
    count = (entry & np.uint64(31)) + size
    return put(out, written, pending, filled, (entry >> np.uint64(5) << size | value) << (np.uint64(64) - count), count)


@kernel
def put_bits(out, written, pending, filled, data, first, last):  # type: ignore[no-untyped-def]
    """Append the bits of ``data`` from ``first`` up to ``last``. Returns as above."""
    most = np.uint64(56)
    while first < last:
        count = min(last - first, most)
        value = word(data, first >> np.uint64(3)) << (first & np.uint64(7))
        value = value >> (np.uint64(64) - count) << (np.uint64(64) - count)
        written, pending, filled = put(out, written, pending, filled, value, count)
        first += count
    return written, pending, filled


@kernel
def refill(data, at, bits, have):  # type: ignore[no-untyped-def]
    """Add whole bytes to ``bits`` until at least 56 are known. Returns ``at, bits, have``."""
    bits |= word(data, at) >> have
    return at + ((np.uint64(63) - have) >> np.uint64(3)), bits, have | np.uint64(56)


@kernel
def skip_ac(data, at, bits, have, codes, quick):  # type: ignore[no-untyped-def]
    """Read the AC coefficients of a block. Returns ``at, bits, have``, and False if they are damaged.

    ``codes`` (65536,) and ``quick`` (2^BITS,) uint16 are the rows of their table, see :func:`excerpt`.
    """
    low, k = np.uint64(15), np.uint64(1)
    while k < 64:
        at, bits, have = refill(data, at, bits, have)
        entry = np.uint64(quick[bits >> np.uint64(64 - BITS)])
        length = entry & np.uint64(31)
        after = k + (entry >> np.uint64(5))
        if after > 64 and after >> np.uint64(6) != 2:  # a long code, or the coefficients end among these codes
            entry = np.uint64(codes[bits >> np.uint64(48)])
            zeros, size = entry >> np.uint64(4) & low, entry & low
            length = (entry >> np.uint64(8)) + size
            after = np.uint64(64) if size == 0 and zeros < low else k + zeros + np.uint64(1)
            if entry == 0 or after > 64:
                return at, bits, have, False
        k = after
        bits <<= length
        have -= length
    return at, bits, have, True


@kernel
def excerpt(data, ends, restart, blocks, codes, quick, dc_codes, grid, window, out):  # type: ignore[no-untyped-def]
    """Read all units of a scan, and write those inside ``window``. Return the bytes written, or DAMAGED.

    ``data`` and ``ends`` are those of :func:`unstuff`, and ``restart`` is the number of units in an interval.
    ``blocks`` (B, 4) int64 holds for each block of a unit its component, 1 if it is the first of that, and the rows of
    its DC and AC table. The tables are ``codes`` (T, 65536) uint16, as in :mod:`.coded`; ``quick`` (T, 2^BITS) uint16,
    for DC every 2^(16-BITS)th entry of the same or 0 where the code is longer, for AC as :func:`combine` writes it;
    and ``dc_codes`` (T, 16) uint64, see :func:`put_dc`. ``grid`` is (columns, rows) of units, ``window`` is (left, top,
    right, bottom) in it. ``out`` receives the bytes without stuffing: the codes as they are, but for the DC
    coefficients whose predecessor is not in the window, or was before a restart marker.
    """
    eight = np.uint64(8)
    columns, rows = grid
    left, top, right, bottom = window
    before, copied = np.zeros(4, np.int64), np.zeros(4, np.int64)  # the last DC coefficients: read, and written
    at, bits, have, end = np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(ends[0])
    written, pending, filled, first = np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0)
    interval, left_of_interval = 0, restart
    for row in range(rows):
        for column in range(columns):
            begins = column == left
            if left_of_interval == 0:
                if not at_end(at, have, end):
                    return DAMAGED
                if top <= row < bottom and left < column < right:  # the codes so far belong together
                    written, pending, filled = put_bits(out, written, pending, filled, data, first, at * eight - have)
                    copied[:] = before
                    begins = True
                at, bits, have = end, np.uint64(0), np.uint64(0)
                interval += 1
                end = np.uint64(ends[interval])
                left_of_interval = restart
                before[:] = 0
            left_of_interval -= 1
            begins = begins and top <= row < bottom
            if begins:
                first = at * eight - have
            for b in range(blocks.shape[0]):
                dc, ac = blocks[b, 2], blocks[b, 3]
                start = at * eight - have
                at, bits, have = refill(data, at, bits, have)
                entry = np.uint64(quick[dc, bits >> np.uint64(64 - BITS)])
                if entry == 0:
                    entry = np.uint64(codes[dc, bits >> np.uint64(48)])
                    if entry == 0:
                        return DAMAGED
                size = entry & np.uint64(15)
                bits <<= entry >> eight
                value = np.int64((bits >> np.uint64(1)) >> (np.uint64(63) - size))
                if value < np.int64(1) << np.int64(size) >> 1:
                    value -= (np.int64(1) << np.int64(size)) - 1
                bits <<= size
                have -= (entry >> eight) + size
                before[blocks[b, 0]] += value
                if begins and blocks[b, 1]:
                    written, pending, filled = put_bits(out, written, pending, filled, data, first, start)
                    difference = before[blocks[b, 0]] - copied[blocks[b, 0]]
                    written, pending, filled = put_dc(out, written, pending, filled, difference, dc_codes[dc])
                    if filled == 64:
                        return DAMAGED
                    first = at * eight - have
                at, bits, have, whole = skip_ac(data, at, bits, have, codes[ac], quick[ac])
                if not whole:
                    return DAMAGED
                if at > end + eight:
                    return DAMAGED
            if column + 1 == right and top <= row < bottom:
                written, pending, filled = put_bits(out, written, pending, filled, data, first, at * eight - have)
                copied[:] = before
    if not at_end(at, have, end):
        return DAMAGED
    ones = (~np.uint64(0) >> filled) if filled else np.uint64(0)
    for i in range(np.uint64(8)):
        out[written + i] = np.uint8((pending | ones) >> (np.uint64(56) - eight * i))
    return np.int64(written + ((filled + np.uint64(7)) >> np.uint64(3)))


@kernel
def at_end(at, have, end):  # type: ignore[no-untyped-def]
    """Return True if the last byte before ``end`` has been begun, and no further one."""
    place, last = np.int64(at) * 8 - np.int64(have), np.int64(end) * 8
    return last - 8 < place <= last
