"""What brings a session's state back into a lane: its newest checkpoint and every operation since."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..lanes.interface import Buffers
from ..lanes.wire import encode_call

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


class Budget:
    """The bytes of all journals together: ``checkpoints``, and the ``frames`` since."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.checkpoints = self.frames = 0

    @property
    def spent(self) -> bool:
        """Whether the limit is reached."""
        return self.checkpoints + self.frames >= self.limit


class Journal:
    """``base`` makes the session, alone, as it was then; ``since`` are the operations that changed it later."""

    def __init__(self, budget: Budget) -> None:
        self.base: Operation | None = None
        self.since: list[Operation] = []
        self.bytes = 0
        self._budget = budget
        self._closed = False

    def add(self, operation: Operation) -> None:
        """``operation`` has changed the session; the first one has made it."""
        if self._closed:
            return
        if self.base is None:
            self.rebase(operation)
            return
        self.since.append(operation)
        self.bytes += operation.bytes
        self._budget.frames += operation.bytes

    def rebase(self, base: Operation) -> None:
        """``base`` makes the session as it is now."""
        if self._closed:
            return
        self._clear()
        self.base = base
        self._budget.checkpoints += base.bytes

    def close(self) -> None:
        """Keep nothing, from now on."""
        self._clear()
        self._closed = True

    def _clear(self) -> None:
        if self.base is not None:
            self._budget.checkpoints -= self.base.bytes
        self._budget.frames -= self.bytes
        self.base, self.since, self.bytes = None, [], 0
