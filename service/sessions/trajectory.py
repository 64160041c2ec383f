"""A session's past: every result, packed, within a bound of bytes."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import msgpack

# What a packed entry costs beyond its own bytes: the objects around it.
OVERHEAD_BYTES = 120


@dataclass(frozen=True, slots=True)
class Entry:
    """One tracked frame: its number, the client's ``ts``, the frame's size, the region, a row a target."""

    seq: int
    ts: float | str | None
    size: list[int]
    region: list[int] | None
    rows: list[list[Any]]


class Trajectory:
    """Entries by rising ``seq``; when the bound is reached the oldest go."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._bytes = 0
        self._packed: deque[tuple[int, bytes]] = deque()

    def __len__(self) -> int:
        return len(self._packed)

    @property
    def first_seq(self) -> int:
        """The oldest frame that is kept; 0 while there is none."""
        return self._packed[0][0] if self._packed else 0

    def append(self, entry: Entry) -> None:
        """Add the newest frame."""
        self.append_packed(entry.seq, msgpack.packb((entry.ts, entry.size, entry.region, entry.rows)))

    def append_packed(self, seq: int, packed: bytes) -> None:
        """Add an entry that :meth:`newest` gave."""
        self._packed.append((seq, packed))
        self._bytes += len(packed) + OVERHEAD_BYTES
        while self._bytes > self._max_bytes and len(self._packed) > 1:
            self._bytes -= len(self._packed.popleft()[1]) + OVERHEAD_BYTES

    def amend(self, rows: list[list[Any]], region: list[int] | None) -> None:
        """The newest frame seen anew, after a box was added or corrected on it."""
        if not self._packed:
            return
        seq, packed = self._packed.pop()
        self._bytes -= len(packed) + OVERHEAD_BYTES
        ts, size, _, _ = msgpack.unpackb(packed)
        self.append(Entry(seq, ts, size, region, rows))

    def newest(self, since: int) -> list[tuple[int, bytes]]:
        """The packed entries from ``since`` on, oldest first; for a few of many."""
        some = list(takewhile(lambda entry: entry[0] >= since, reversed(self._packed)))
        return some[::-1]

    def after(self, seq: int) -> list[tuple[int, bytes]]:
        """The packed entries above ``seq``, oldest first; see :func:`unpacked`."""
        packed = list(self._packed)
        return packed[bisect_right(packed, seq, key=lambda entry: entry[0]) :]


def unpacked(packed: list[tuple[int, bytes]]) -> Iterator[Entry]:
    """The entries that :meth:`Trajectory.after` gave."""
    for seq, entry in packed:
        yield Entry(seq, *msgpack.unpackb(entry))
