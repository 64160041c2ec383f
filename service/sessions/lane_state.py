"""A session's state in a lane, which outlives the lane."""

from __future__ import annotations

import asyncio
import time
from typing import Any
from zlib import crc32

import structlog

from ..lanes.framing import decode_reply
from ..lanes.interface import LaneLost, Lanes
from ..observability.metrics import Metrics
from ..protocol.problems import ProblemError
from ..settings import Settings
from .replay_log import Operation, RecoveryBudget, ReplayLog

# One object: a session whose checkpoint ends two lanes is as poisonous as a frame that does.
CHECKPOINT = Operation("checkpoint", {})
# What may have changed the state: a control that is refused for want of pixels asks for a whole frame.
CHANGING = (None, "full-frame-needed")

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.recovery")


class RestoreSlots(dict[int, asyncio.Semaphore]):
    """Who restores in a lane: side by side all would be late, and one alone would leave the lane waiting."""

    def __missing__(self, lane: int) -> asyncio.Semaphore:
        return self.setdefault(lane, asyncio.Semaphore(2))


class Poisoned(Exception):
    """One operation has ended two lanes in a row, or the state cannot be read; the text may be shown.

    ``late``: the lanes did not die by themselves, the operation took too long.
    """

    def __init__(self, detail: str, *, late: bool = False) -> None:
        super().__init__(detail)
        self.late = late


class LaneState:
    """Its methods are called one at a time.

    They raise LaneLost when the key is released, Poisoned, and at-capacity if no lane becomes ready.
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
        self.replay_log = ReplayLog(budget)
        self._restore_slots = restore_slots
        self._key, self._owner, self._lanes, self._budget = key, owner, lanes, budget
        self._settings, self._metrics = settings, metrics
        self._suspect: Operation | None = None
        self._outcome_unknown = False
        # So early that a checkpoint is on disk before the one before it is older than is said.
        self._every = max(1, settings.checkpoint_every_frames - settings.checkpoint_every_frames // 4)
        # Sessions that began together should not all take their checkpoints at the same frame.
        self._frames_until_checkpoint = 1 + crc32(key.encode()) % self._every

    @property
    def checkpoint_due(self) -> str | None:
        """Why a checkpoint is to be taken now, if one is."""
        if len(self.replay_log.operations) >= self._frames_until_checkpoint:
            return "frames"
        if 2 * self.replay_log.bytes >= self._settings.max_replay_bytes:
            return "bytes"
        return "budget" if self.replay_log.operations and self._budget.spent else None

    @property
    def has_lane(self) -> bool:
        """Whether a lane has a place for it."""
        return self._lanes.holds(self._key)

    async def call(self, operation: Operation, *, changes: bool) -> tuple[str | None, Any]:
        """The lane's answer; if the lane is lost, that of the one in which the state is restored.

        With ``changes`` the operation is made again whenever the state is restored, unless it was refused.
        """
        replay_log = self.replay_log
        if changes and replay_log.operations and replay_log.bytes + operation.bytes > self._settings.max_replay_bytes:
            await self.checkpoint("bytes")
        await self._roll_back_if_unknown()
        # Given up or broken off, an operation may be done, half done or not done; it shall not be.
        self._outcome_unknown = changes
        code, value = await self._call_with_recovery(operation)
        self._outcome_unknown = changes and code == "internal"
        if changes and code in CHANGING:
            replay_log.append(operation)
        return code, value

    async def checkpoint(self, reason: str) -> None:
        """Keep the state as it is now in place of what led to it."""
        started = time.monotonic()
        await self._roll_back_if_unknown()
        code, value = await self._call_with_recovery(CHECKPOINT)
        if code is not None:
            log.error("fault in a lane", session=self._key, op="checkpoint", fault=value[0])
            return
        self.replay_log.reset_to(Operation("revive", {}, value))
        self._frames_until_checkpoint = self._every
        self._metrics.checkpoint(reason, len(value), time.monotonic() - started)

    async def move(self, lane: int) -> None:
        """Go on in another lane from the newest checkpoint, if there is room for it."""
        if not self._lanes.move(self._key, lane):
            return
        started, frames = time.monotonic(), len(self.replay_log.operations)
        self._outcome_unknown = True  # until it is there: broken off, the move is made up for by the next operation
        await self._restore()
        self._outcome_unknown = False
        self._metrics.moves.inc()
        seconds = round(time.monotonic() - started, 4)
        log.info("session moved", session=self._key, lane=lane, frames=frames, seconds=seconds)

    async def recover(self, cause: str = "") -> None:
        """Restore the state in a lane, as soon as one is ready; ``cause`` is told where no lane was lost."""
        started = time.monotonic()
        cause = await self._restore() or cause
        if self.replay_log.checkpoint is not None:
            seconds, frames = time.monotonic() - started, len(self.replay_log.operations)
            self._metrics.recovered(cause, frames, seconds)
            log.info("session restored", session=self._key, cause=cause, frames=frames, seconds=round(seconds, 4))

    async def _restore(self) -> str:
        """Make the state again in the lane that has a place for it; what became of its lane before, if it was lost."""
        while True:
            try:
                async with asyncio.timeout(self._settings.recovery_timeout_s):
                    place = await self._lanes.regain(self._key, self._owner)
                async with self._restore_slots[place.lane]:
                    await self._replay()
                return place.cause
            except TimeoutError:
                raise ProblemError("at-capacity", "no lane is ready for the session", retry_after_s=1.0) from None
            except LaneLost as lost:
                if lost.cause == "released":
                    raise

    async def _roll_back_if_unknown(self) -> None:
        """If it is not sure what the last operation has done, go back to before it."""
        if self._outcome_unknown:
            await self.recover("fault")
            self._outcome_unknown = False

    async def _call_with_recovery(self, operation: Operation) -> tuple[str | None, Any]:
        while True:
            try:
                return await self._send_once(operation)
            except LaneLost as lost:
                if lost.cause == "released":
                    raise
                await self.recover()

    async def _replay(self) -> None:
        base = self.replay_log.checkpoint
        if base is None:
            return
        code, value = await self._send_once(base)
        if code is not None:
            log.error("session cannot be restored", session=self._key, op=base.op, code=code, detail=value[0])
            raise Poisoned("its state cannot be restored")
        for operation in self.replay_log.operations:
            await self._send_once(operation)

    async def _send_once(self, operation: Operation) -> tuple[str | None, Any]:
        try:
            reply = await self._lanes.call(self._key, operation.request(self._key))
        except LaneLost as lost:
            if lost.in_work and lost.cause != "released":
                if self._suspect is operation:
                    raise Poisoned(_poison(operation, lost), late=lost.cause == "hung") from lost
                self._suspect = operation
            raise
        if self._suspect is operation:
            self._suspect = None
        return decode_reply(reply)


def _poison(operation: Operation, lost: LaneLost) -> str:
    what = f"frame {operation.args['seq']}" if operation.op == "track" else f"the {operation.op}"
    return f"{what} took too long twice" if lost.cause == "hung" else f"{what} ended its worker twice"
