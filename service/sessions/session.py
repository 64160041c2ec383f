"""One session as the front knows it, and the operations on it, one at a time."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict
from datetime import datetime
from typing import Any, TypeVar

import structlog

from ..lanes.interface import LaneLost
from ..observability.stages import Stages
from ..protocol.answers import Result, Timing, message
from ..protocol.enums import EndReason, ProblemCode
from ..protocol.problems import ProblemError, session_gone
from ..protocol.requests import Options
from ..protocol.target import Row, row_to_map, rows_to_maps
from ..protocol.values import MAX_SEQ
from .interface import AttachedStream, QueuedFrame
from .lane_state import LaneState, Poisoned
from .rate_limiter import TokenBucket
from .replay_log import Operation
from .trajectory import TrajectoryEntry, TrajectoryLog

T = TypeVar("T")

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.session")


class Session:
    """Numbers the frames of a session, and lets one operation at a time act on its state.

    ``ended`` is the reason once the session has ended. ``on_saveable`` is called between two operations when a
    checkpoint or the first frame is kept, ``on_poison`` when the session cannot go on, with a text for the client.
    """

    def __init__(
        self,
        sid: str,
        owner: str,
        options: Options,
        lane: LaneState,
        *,
        on_saveable: Callable[[Session], None],
        on_poison: Callable[[Session, str], None],
        ordinal: int,
        created: float,
        created_at: datetime,
        max_trajectory_bytes: int,
        clock: Callable[[], float],
        max_messages_per_s: float,
    ) -> None:
        self.id, self.owner, self.options = sid, owner, options
        self.ordinal, self.created, self.created_at = ordinal, created, created_at
        # Not ``created``: that may be before a restart, and time in which the service was down is not idle time.
        self.touched = clock()
        self.ended: EndReason | None = None
        self.attachment: AttachedStream | None = None
        self.size: list[int] = [0, 0]
        self.region: list[int] | None = None
        self.rows: list[Row] = []
        self.seq = 0
        self.last_number = 0
        self.http_waiting = 0
        self.lost_after: int | None = None
        self.saved_to = -1
        # Of the claim under which it is saved; and whether another node goes on with it.
        self.epoch = 0
        self.handed_over = False
        self.trajectory = TrajectoryLog(max_trajectory_bytes)
        self.messages = TokenBucket(max_messages_per_s, time.monotonic())
        self.lane = lane
        self._on_saveable, self._on_poison = on_saveable, on_poison
        self._turn = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()
        self._clock = clock
        self._calls = 0
        self._restore_scheduled = self._restoring = False

    @property
    def busy(self) -> bool:
        """Whether a frame or call is received or in work, or the state is being restored."""
        return self._calls > 0 or self._turn.locked()

    @contextmanager
    def in_use(self) -> Iterator[None]:
        """Keep the session from ending as idle in this block, because a body may take long to arrive."""
        self._calls += 1
        try:
            yield
        finally:
            self._calls -= 1
            self.touch()

    def touch(self) -> None:
        """Count the session as used now; its idle time starts again."""
        self.touched = self._clock()

    def number(self, seq: int | None) -> int:
        """Return the number of a frame message: the client's own, or the next one. Raises stale-frame."""
        if seq is None:
            seq = self.last_number + 1
            if seq > MAX_SEQ:
                raise ProblemError(ProblemCode.STALE_FRAME, "no number is left above the last one")
        elif seq <= self.last_number:
            raise ProblemError(ProblemCode.STALE_FRAME, f"seq {seq} is not above {self.last_number}")
        self.last_number = seq
        return seq

    async def start(self, data: bytes | memoryview, boxes: list[list[float]]) -> None:
        """Start a target on every box of the first frame."""
        async with self._turn:
            args = {"options": asdict(self.options), "boxes": boxes}
            self._take(await self._call("create", args, data, changes=True))
            self.trajectory.append(TrajectoryEntry(0, None, self.size, self.region, self.rows))
            self._on_saveable(self)

    async def restore(self, data: bytes | memoryview) -> Options:
        """Start from the bytes that :meth:`snapshot` returned, and return the options of that session."""
        async with self._turn:
            state = await self._call("restore", {}, data, changes=True)
            self._take(state)
            self.last_number = self.seq
        return Options(**state["options"])

    async def track(
        self, frame: QueuedFrame, *, dropped: int = 0, controls: list[dict[str, Any]] | None = None
    ) -> tuple[dict[str, Any], list[ProblemError | None], Stages]:
        """Track all targets in one frame, on which ``controls`` act. Raises ProblemError; then nothing has changed.

        Return the Result of the protocol, for each control None or its refusal, and the time that each stage took.
        ``dropped`` is the number of frames superseded since the previous result.
        """
        args: dict[str, Any] = {"seq": frame.seq}
        if frame.region is not None:
            args["region"] = frame.region
        if controls:
            args["controls"] = controls
        async with self._turn:
            begun = time.monotonic()
            state = await self._call("track", args, frame.data, changes=True)
            self._take(state)
            self.trajectory.append(TrajectoryEntry(frame.seq, frame.ts, self.size, self.region, self.rows))
            self.lost_after = None
        done = time.monotonic()
        decode_s, track_s = state["decode_s"], state["track_s"]
        transit_s = max(0.0, done - begun - decode_s - track_s)
        stages = Stages(frame.queued - frame.arrived, begun - frame.queued, transit_s, decode_s, track_s)
        result = message(
            Result,
            seq=frame.seq,
            ts=frame.ts,
            size=self.size,
            dropped=dropped,
            region=self.region,
            targets=rows_to_maps(self.rows, state.get("maps")),
            timing=message(
                Timing,
                queue_ms=round((stages.receive + stages.queue + transit_s) * 1e3, 3),
                decode_ms=round(decode_s * 1e3, 3),
                track_ms=round(track_s * 1e3, 3),
            ),
        )
        answers = [refused and _refusal(*refused) for refused in state["answers"]] if controls else []
        return result, answers, stages

    async def control(self, control: Mapping[str, Any]) -> tuple[dict[str, Any] | None, list[int] | None]:
        """Add, correct or remove a target on the newest frame. Return the target, unless removed, and the region."""
        async with self._turn:
            try:
                state = await self._call("control", control, changes=True)
            except ProblemError as refused:
                if refused.code == ProblemCode.FULL_FRAME_NEEDED:
                    self.region = refused.members["region"]
                raise
            self._take(state)
            if control["type"] != "remove":
                self.trajectory.amend(self.rows, self.region)
        row = next((row for row in self.rows if row[0] == state["target"]), None)
        return None if row is None else row_to_map(row), self.region

    async def snapshot(self) -> bytes | memoryview:
        """Return the session as bytes, taken between two frames and not signed."""
        async with self._turn:
            data: bytes | memoryview = await self._call("snapshot", {"options": asdict(self.options)})
        return data

    def target_maps(self) -> list[dict[str, Any]]:
        """Return the Targets of the protocol as the newest frame left them."""
        return rows_to_maps(self.rows)

    def restore_lane_state(self) -> None:
        """Have the state restored in a lane, now that its lane is lost."""
        if not self._restore_scheduled:
            self._restore_scheduled = True
            self._schedule(self._restore_lane_state())

    def move(self, lane: int) -> None:
        """Have the session go on in another lane, between two frames."""
        self._schedule(self._move(lane))

    async def prepare_to_stop(self) -> None:
        """Finish what is in work, and keep a checkpoint of the state as it is then. Raises like every operation."""
        if self._restoring and not self.lane.replay_log.operations:
            return  # the checkpoint is up to date, and it may be long until a lane is ready
        async with self._turn:
            if self.lane.replay_log.operations and not self.ended:
                await self._in_lane(self.lane.checkpoint("stop"))

    async def wait_until_idle(self) -> None:
        """Wait until nothing is in work."""
        async with self._turn:
            pass

    def _take(self, state: dict[str, Any]) -> None:
        self.seq, self.size, self.region, self.rows = state["seq"], state["size"], state["region"], state["rows"]

    def _schedule(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _checkpoint_if_due(self) -> None:
        """Take a checkpoint after a frame was answered, if one is due."""
        with suppress(ProblemError):
            async with self._turn:
                if not self.ended and (reason := self.lane.checkpoint_due):
                    await self._checkpoint(reason)

    async def _restore_lane_state(self) -> None:
        try:
            async with self._turn:
                if not self.ended and not self.lane.has_lane:
                    self._restoring = True
                    await self._in_lane(self.lane.recover())
        except ProblemError as refused:
            log.warning("session not restored", session=self.id, code=refused.code)
        finally:
            self._restore_scheduled = self._restoring = False
            self.touch()

    async def _move(self, lane: int) -> None:
        try:
            async with self._turn:
                if not self.ended and self.lane.has_lane:
                    await self._checkpoint("move")
                    await self._in_lane(self.lane.move(lane))
        except ProblemError as refused:
            log.warning("session not moved", session=self.id, lane=lane, code=refused.code)

    async def _checkpoint(self, reason: str) -> None:
        await self._in_lane(self.lane.checkpoint(reason))
        self._on_saveable(self)

    async def _call(
        self, op: str, args: Mapping[str, Any], data: bytes | memoryview = b"", *, changes: bool = False
    ) -> Any:
        """Do an operation in the session's lane and return its value. Raises ProblemError."""
        if self.ended:
            raise session_gone(self.ended)
        if self.handed_over:
            raise ProblemError(ProblemCode.DRAINING, "the session goes on at another node", retry_after_s=1.0)
        try:
            code, value = await self._in_lane(self.lane.call(Operation(op, args, data), changes=changes))
        finally:
            self.touch()
        if changes and self.lane.checkpoint_due and not self._tasks:
            self._schedule(self._checkpoint_if_due())
        if code is None:
            return value
        if code == ProblemCode.INTERNAL:
            log.error("fault in a lane", session=self.id, op=op, fault=value[0])
            raise ProblemError(ProblemCode.INTERNAL, "the fault is logged under the request id")
        raise _refusal(code, *value)

    async def _in_lane(self, work: Awaitable[T]) -> T:
        """Await work of the lane state; what makes the session end raises session-gone."""
        try:
            return await work
        except LaneLost as lost:
            raise session_gone(self.ended or EndReason.LOST) from lost
        except Poisoned as poisoned:
            log.error("session is poisoned", session=self.id, fault=str(poisoned))
            if self.lane.replay_log.checkpoint is not None:
                self._on_poison(self, str(poisoned))
                raise session_gone(EndReason.LOST, str(poisoned)) from poisoned
            # The session has not started.
            if poisoned.late:
                raise ProblemError(ProblemCode.DEADLINE_EXCEEDED, "the operation took too long") from poisoned
            raise ProblemError(ProblemCode.INTERNAL, "the operation ended its worker") from poisoned


def _refusal(code: str, detail: str, members: dict[str, Any]) -> ProblemError:
    return ProblemError(ProblemCode(code), detail, **members)
