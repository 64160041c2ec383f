"""What brings a session's state back into a lane: its newest checkpoint and every operation since."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..lanes.framing import encode_call
from ..lanes.interface import Buffers

# What an operation costs beyond its image.
OVERHEAD_BYTES = 1024


@dataclass(frozen=True, slots=True, eq=False)
class Operation:
    """A call to a lane that can be made again; two are the same only if they are one object."""

    op: str
    args: Mapping[str, Any]
    data: bytes | memoryview = b""

    @property
    def bytes(self) -> int:
        """About what it takes to keep it."""
        return len(self.data) + OVERHEAD_BYTES

    def request(self, key: str) -> Buffers:
        """The call for the session ``key``."""
        return encode_call(self.op, key, self.args, self.data)


class RecoveryBudget:
    """The bytes of all journals together: ``checkpoints``, and the ``frames`` since."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.checkpoints = self.frames = 0

    @property
    def spent(self) -> bool:
        """Whether the limit is reached."""
        return self.checkpoints + self.frames >= self.limit


class ReplayLog:
    """``base`` makes the session, alone, as it was then; ``since`` are the operations that changed it later."""

    def __init__(self, budget: RecoveryBudget) -> None:
        self.checkpoint: Operation | None = None
        self.operations: list[Operation] = []
        self.bytes = 0
        self._budget = budget
        self._closed = False

    def append(self, operation: Operation) -> None:
        """``operation`` has changed the session; the first one has made it."""
        if self._closed:
            return
        if self.checkpoint is None:
            self.reset_to(operation)
            return
        self.operations.append(operation)
        self.bytes += operation.bytes
        self._budget.frames += operation.bytes

    def reset_to(self, checkpoint: Operation) -> None:
        """Start anew from ``checkpoint``, which makes the session as it is now."""
        if self._closed:
            return
        self._clear()
        self.checkpoint = checkpoint
        self._budget.checkpoints += checkpoint.bytes

    def close(self) -> None:
        """Keep nothing, from now on."""
        self._clear()
        self._closed = True

    def _clear(self) -> None:
        if self.checkpoint is not None:
            self._budget.checkpoints -= self.checkpoint.bytes
        self._budget.frames -= self.bytes
        self.checkpoint, self.operations, self.bytes = None, [], 0
