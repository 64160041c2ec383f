"""The past of a session: every result, packed, within a bound of bytes."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import takewhile

import msgpack

from ..protocol.target import Row, complete

# What a packed entry costs beyond its own bytes: the objects around it.
OVERHEAD_BYTES = 120


@dataclass(frozen=True, slots=True)
class TrajectoryEntry:
    """One tracked frame: its number, the client's ``ts``, the frame's size, the region, and a row for each target."""

    seq: int
    ts: float | str | None
    size: list[int]
    region: list[int] | None
    rows: list[Row]


class TrajectoryLog:
    """Entries by rising ``seq``. When the bound is reached, the oldest are dropped."""

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

    def append(self, entry: TrajectoryEntry) -> None:
        """Add the newest frame."""
        self.append_packed(entry.seq, msgpack.packb((entry.ts, entry.size, entry.region, entry.rows)))

    def append_packed(self, seq: int, packed: bytes) -> None:
        """Add an entry that :meth:`newest` returned."""
        self._packed.append((seq, packed))
        self._bytes += len(packed) + OVERHEAD_BYTES
        while self._bytes > self._max_bytes and len(self._packed) > 1:
            self._bytes -= len(self._packed.popleft()[1]) + OVERHEAD_BYTES

    def amend(self, rows: list[Row], region: list[int] | None) -> None:
        """Replace the results of the newest frame, after a target was added or corrected on it."""
        if not self._packed:
            return
        seq, packed = self._packed.pop()
        self._bytes -= len(packed) + OVERHEAD_BYTES
        ts, size, _, _ = msgpack.unpackb(packed)
        self.append(TrajectoryEntry(seq, ts, size, region, rows))

    def newest(self, since: int) -> list[tuple[int, bytes]]:
        """Return the packed entries from ``since`` on, oldest first. This is fast for a few entries of many."""
        some = list(takewhile(lambda entry: entry[0] >= since, reversed(self._packed)))
        return some[::-1]

    def after(self, seq: int) -> list[tuple[int, bytes]]:
        """Return the packed entries above ``seq``, oldest first; see :func:`unpacked`."""
        packed = list(self._packed)
        return packed[bisect_right(packed, seq, key=lambda entry: entry[0]) :]


def unpacked(packed: list[tuple[int, bytes]]) -> Iterator[TrajectoryEntry]:
    """Yield the entries that :meth:`TrajectoryLog.after` returned, those of earlier versions with all fields."""
    for seq, entry in packed:
        ts, size, region, rows = msgpack.unpackb(entry)
        yield TrajectoryEntry(seq, ts, size, region, [complete(row) for row in rows])
