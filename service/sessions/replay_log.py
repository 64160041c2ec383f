"""The log that brings a session's state back into a lane: its newest checkpoint, and every operation since."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ..lanes.framing import encode_call
from ..lanes.interface import Buffers

# What it costs to keep an operation, beyond its image.
OVERHEAD_BYTES = 1024


@dataclass(frozen=True, slots=True, eq=False)
class Operation:
    """A call to a lane that can be made again. Two are the same only if they are one object."""

    op: str
    args: Mapping[str, Any]
    data: bytes | memoryview = b""

    @property
    def bytes(self) -> int:
        """About the memory that it takes to keep the operation."""
        return len(self.data) + OVERHEAD_BYTES

    def request(self, key: str) -> Buffers:
        """Return the call for the session ``key``."""
        return encode_call(self.op, key, self.args, self.data)


class RecoveryBudget:
    """Counts the bytes of all replay logs: of their ``checkpoints``, and of the ``frames`` since.

    A single owner may fill the limit. Each of several may hold as much as it leaves free, so that the large frames of
    one do not keep the others from sessions. ``owners`` returns their number now.
    """

    def __init__(self, limit: int, owners: Callable[[], int] = lambda: 1) -> None:
        self.limit, self._owners = limit, owners
        self.checkpoints = self.frames = 0
        self._held_by: Counter[str] = Counter()

    def change(self, owner: str, *, checkpoints: int = 0, frames: int = 0) -> None:
        """Count so many bytes more of an owner, fewer if negative."""
        self.checkpoints += checkpoints
        self.frames += frames
        self._held_by[owner] += checkpoints + frames
        if not self._held_by[owner]:
            del self._held_by[owner]

    def spent(self, owner: str) -> bool:
        """Return whether the limit is reached, or the share of this owner."""
        free = self.limit - self.checkpoints - self.frames
        return free <= 0 or (free <= self._held_by[owner] and self._owners() > 1)


class ReplayLog:
    """``checkpoint`` makes the session by itself as it was then; ``operations`` have changed it since."""

    def __init__(self, budget: RecoveryBudget, owner: str) -> None:
        self.checkpoint: Operation | None = None
        self.operations: list[Operation] = []
        self.bytes = 0
        self._budget, self._owner = budget, owner
        self._closed = False

    def append(self, operation: Operation) -> None:
        """Add an operation that has changed the session; the first one has made it."""
        if self._closed:
            return
        if self.checkpoint is None:
            self.reset_to(operation)
            return
        size = operation.bytes
        self.operations.append(operation)
        self.bytes += size
        self._budget.change(self._owner, frames=size)

    def reset_to(self, checkpoint: Operation) -> None:
        """Replace the whole log by ``checkpoint``, which makes the session as it is now."""
        if self._closed:
            return
        self._clear()
        self.checkpoint = checkpoint
        self._budget.change(self._owner, checkpoints=checkpoint.bytes)

    def close(self) -> None:
        """Empty the log, and keep nothing from now on."""
        self._clear()
        self._closed = True

    def _clear(self) -> None:
        kept = self.checkpoint.bytes if self.checkpoint else 0
        self._budget.change(self._owner, checkpoints=-kept, frames=-self.bytes)
        self.checkpoint, self.operations, self.bytes = None, [], 0
