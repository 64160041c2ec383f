"""The state of a session in a lane, which survives the loss of the lane."""

from __future__ import annotations

import asyncio
import time
from typing import Any
from zlib import crc32

import structlog

from ..lanes.framing import decode_reply
from ..lanes.interface import LaneLost, Lanes
from ..observability.metrics import Metrics
from ..protocol.enums import LaneLoss, ProblemCode
from ..protocol.problems import ProblemError
from ..settings import Settings
from .replay_log import Operation, RecoveryBudget, ReplayLog

# One object, so that a session whose checkpoint ends two lanes is recognised like a frame that does.
CHECKPOINT = Operation("checkpoint", {})
# The answers after which the state may have changed: a control that lacks pixels makes the region the whole frame.
CHANGING = (None, ProblemCode.FULL_FRAME_NEEDED)

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.recovery")


class RestoreSlots(dict[int, asyncio.Semaphore]):
    """For each lane, the slots for sessions that are restored in it.

    If all were restored side by side, all would be late; one at a time would leave the lane waiting.
    """

    def __missing__(self, lane: int) -> asyncio.Semaphore:
        return self.setdefault(lane, asyncio.Semaphore(2))


class Poisoned(Exception):
    """One operation has ended two lanes in a row, or the state cannot be read. The text may be shown to clients.

    ``late`` is True if the lanes did not die by themselves, but the operation took too long.
    """

    def __init__(self, detail: str, *, late: bool = False) -> None:
        super().__init__(detail)
        self.late = late


class LaneState:
    """Keeps a session's state in some lane. Its methods are called one at a time.

    They raise LaneLost if the key is released, Poisoned, and at-capacity if no lane becomes ready.
    """

    def __init__(
        self,
        key: str,
        owner: str,
        lanes: Lanes,
        restore_slots: RestoreSlots,
        budget: RecoveryBudget,
        settings: Settings,
        metrics: Metrics,
    ) -> None:
        self.replay_log = ReplayLog(budget, owner)
        self._restore_slots = restore_slots
        self._key, self._owner, self._lanes, self._budget = key, owner, lanes, budget
        self._settings, self._metrics = settings, metrics
        self._max_replay_bytes = settings.max_replay_bytes
        self._suspect: Operation | None = None
        self._outcome_unknown = False
        # At three quarters of the interval, so that the newest checkpoint on disk is never older than the interval.
        self._every = max(1, settings.checkpoint_every_frames - settings.checkpoint_every_frames // 4)
        # Sessions that began together take their checkpoints at different frames.
        self._frames_until_checkpoint = 1 + crc32(key.encode()) % self._every

    @property
    def checkpoint_due(self) -> str | None:
        """Why a checkpoint should be taken now; None if it should not."""
        if len(self.replay_log.operations) >= self._frames_until_checkpoint:
            return "frames"
        if 2 * self.replay_log.bytes >= self._max_replay_bytes:
            return "bytes"
        return "budget" if self.replay_log.operations and self._budget.spent(self._owner) else None

    @property
    def has_lane(self) -> bool:
        """Whether the session has a place in a lane."""
        return self._lanes.holds(self._key)

    async def call(self, operation: Operation, *, changes: bool) -> tuple[str | None, Any]:
        """Do an operation in the lane, or in the next one if it is lost, and return ``code, value`` of the reply.

        With ``changes`` the operation is part of the state from now on, unless it was refused: whenever the state is
        restored, it is done again.
        """
        replay_log = self.replay_log
        if changes and replay_log.operations and replay_log.bytes + operation.bytes > self._max_replay_bytes:
            await self.checkpoint("bytes")
        if self._outcome_unknown:
            await self._roll_back()
        # If this call is cancelled, it is unknown what it did; the next call rolls it back.
        self._outcome_unknown = changes
        code, value = await self._send(operation)
        self._outcome_unknown = changes and code == ProblemCode.INTERNAL
        if changes and code in CHANGING:
            replay_log.append(operation)
        return code, value

    async def checkpoint(self, reason: str) -> None:
        """Replace the replay log by the state as it is now."""
        started = time.monotonic()
        if self._outcome_unknown:
            await self._roll_back()
        code, value = await self._send(CHECKPOINT)
        if code is not None:
            log.error("fault in a lane", session=self._key, op="checkpoint", fault=value[0])
            return
        self.replay_log.reset_to(Operation("revive", {}, value))
        self._frames_until_checkpoint = self._every
        self._metrics.checkpoint(reason, len(value), time.monotonic() - started)

    async def move(self, lane: int) -> None:
        """Restore the state in another lane, if there is room for it."""
        if not self._lanes.move(self._key, lane):
            return
        started, frames = time.monotonic(), len(self.replay_log.operations)
        self._outcome_unknown = True  # if the move is cancelled, the next operation completes it
        await self._restore()
        self._outcome_unknown = False
        self._metrics.moves.inc()
        seconds = round(time.monotonic() - started, 4)
        log.info("session moved", session=self._key, lane=lane, frames=frames, seconds=seconds)

    async def recover(self, cause: str = "") -> None:
        """Restore the state in a lane, as soon as one is ready. ``cause`` is reported if no lane was lost."""
        started = time.monotonic()
        cause = await self._restore() or cause
        if self.replay_log.checkpoint is not None:
            seconds, frames = time.monotonic() - started, len(self.replay_log.operations)
            self._metrics.recovered(cause, frames, seconds)
            log.info("session restored", session=self._key, cause=cause, frames=frames, seconds=round(seconds, 4))

    async def _restore(self) -> str:
        """Replay the log in a lane with a place for the session; return why the lane before was lost, if it was."""
        while True:
            try:
                async with asyncio.timeout(self._settings.recovery_timeout_s):
                    place = await self._lanes.regain(self._key, self._owner)
                async with self._restore_slots[place.lane]:
                    await self._replay()
                return place.cause
            except TimeoutError:
                detail = "no lane is ready for the session"
                raise ProblemError(ProblemCode.AT_CAPACITY, detail, retry_after_s=1.0) from None
            except LaneLost as lost:
                if lost.cause == LaneLoss.RELEASED:
                    raise

    async def _roll_back(self) -> None:
        """Go back to before the last operation, because it is unknown what that has done."""
        await self.recover(LaneLoss.FAULT)
        self._outcome_unknown = False

    async def _replay(self) -> None:
        checkpoint = self.replay_log.checkpoint
        if checkpoint is None:
            return
        code, value = await self._send(checkpoint, recover=False)
        if code is not None:
            op, detail = checkpoint.op, value[0]
            log.error("session cannot be restored", session=self._key, op=op, code=code, detail=detail)
            raise Poisoned("its state cannot be restored")
        for operation in self.replay_log.operations:
            await self._send(operation, recover=False)

    async def _send(self, operation: Operation, *, recover: bool = True) -> tuple[str | None, Any]:
        """Send an operation and return ``code, value`` of the reply; with ``recover``, again if the lane is lost."""
        while True:
            try:
                reply = await self._lanes.call(self._key, operation.request(self._key))
            except LaneLost as lost:
                if lost.cause == LaneLoss.RELEASED:
                    raise
                if lost.in_work:
                    if self._suspect is operation:
                        late = lost.cause == LaneLoss.HUNG
                        raise Poisoned(_describe_poison(operation, late), late=late) from lost
                    self._suspect = operation
                if not recover:
                    raise
                await self.recover()
            else:
                if self._suspect is operation:
                    self._suspect = None
                return decode_reply(reply)


def _describe_poison(operation: Operation, late: bool) -> str:
    what = f"frame {operation.args['seq']}" if operation.op == "track" else f"the {operation.op}"
    return f"{what} took too long twice" if late else f"{what} ended its worker twice"
