"""One session as the front knows it, and the operations on it, one at a time."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Protocol, TypeVar

import structlog

from ..keys import Identity
from ..lanes.interface import LaneLost
from ..observability.stages import Stages
from ..protocol.problems import ProblemError, session_gone
from ..protocol.values import MAX_SEQ
from . import wiring
from .lane_state import LaneState, Poisoned
from .rate_limiter import TokenBucket
from .replay_log import Operation
from .trajectory import Entry, Trajectory

T = TypeVar("T")

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.session")


@dataclass(frozen=True, slots=True)
class Options:
    """What the client chose."""

    preset: str
    on_resize: str
    label: str | None
    maps: bool
    idle_timeout_s: float


@dataclass(slots=True)
class Frame:
    """A frame message with its number, on its way to the lane; ``arrived``, ``queued`` are of the monotonic clock."""

    data: bytes
    seq: int
    ts: float | str | None
    region: list[int] | None
    arrived: float
    queued: float


class Attachment(Protocol):
    """What a session knows of the stream that is attached to it; ``name`` is known to its owner alone."""

    name: str
    identity: Identity

    def tell(self, message: dict[str, Any]) -> None:
        """Send a message when there is room."""

    def finish(self, code: int, reason: str) -> None:
        """Read no more, answer what has been read, and close."""

    def end(self, code: int, reason: str) -> None:
        """Close; what waits is discarded."""

    def check(self, now: float) -> None:
        """Close if the client has stopped reading."""


class Session:
    """State, numbering and the one-at-a-time rule; ``ended`` is the reason once it has.

    ``on_saveable`` is called when a checkpoint or the first frame is kept, between two operations, ``on_poison``
    when the session cannot go on, with what may be told.
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
        # Not since it was made: that may have been before a restart, and time spent down is not idle time.
        self.touched = clock()
        self.ended: str | None = None
        self.attachment: Attachment | None = None
        self.size: list[int] = [0, 0]
        self.region: list[int] | None = None
        self.rows: list[list[Any]] = []
        self.seq = 0
        self.last_number = 0
        self.http_waiting = 0
        self.lost_after: int | None = None
        self.saved_to = -1
        self.trajectory = Trajectory(max_trajectory_bytes)
        self.messages = TokenBucket(max_messages_per_s, time.monotonic())
        self.lane = lane
        self._on_saveable, self._on_poison = on_saveable, on_poison
        self._turn = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()
        self._clock = clock
        self._calls = 0
        self._reviving = self._restoring = False

    @property
    def busy(self) -> bool:
        """Whether a frame or call is being received or in work, or the state is being restored."""
        return self._calls > 0 or self._turn.locked()

    @contextmanager
    def in_use(self) -> Iterator[None]:
        """Keep the session from ending as idle meanwhile: a body may be long in coming."""
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
        """The number of a frame message, the client's own or the next. Raises stale-frame."""
        if seq is None:
            seq = self.last_number + 1
            if seq > MAX_SEQ:
                raise ProblemError("stale-frame", "no number is left above the last")
        elif seq <= self.last_number:
            raise ProblemError("stale-frame", f"seq {seq} is not above {self.last_number}")
        self.last_number = seq
        return seq

    async def begin(self, data: bytes, boxes: list[list[float]]) -> None:
        """Start on the first frame."""
        chosen = self.options
        options = {"preset": chosen.preset, "on_resize": chosen.on_resize, "maps": chosen.maps}
        async with self._turn:
            state = await self._call("create", {"options": options, "boxes": boxes}, data, changes=True)
            self._take(state)
            self.trajectory.append(Entry(0, None, self.size, self.region, self.rows))
            self._on_saveable(self)

    async def resume(self, data: bytes) -> dict[str, Any]:
        """Start from what :meth:`snapshot` gave; what the front put into it."""
        async with self._turn:
            state = await self._call("restore", {}, data, changes=True)
            self._take(state)
            self.last_number = self.seq
        return {**state["front"], **state["options"]}

    async def track(
        self, frame: Frame, *, dropped: int = 0, controls: list[dict[str, Any]] | None = None
    ) -> tuple[dict[str, Any], list[ProblemError | None], Stages]:
        """The Result of one frame; for each of ``controls``, which act on it, None or its refusal; the time it took."""
        args: dict[str, Any] = {"seq": frame.seq}
        if frame.region is not None:
            args["region"] = frame.region
        if controls:
            args["controls"] = controls
        async with self._turn:
            begun = time.monotonic()
            state = await self._call("track", args, frame.data, changes=True)
            self._take(state)
            self.trajectory.append(Entry(frame.seq, frame.ts, self.size, self.region, self.rows))
            self.lost_after = None
        done = time.monotonic()
        decode_s, track_s = state["decode_s"], state["track_s"]
        transit_s = max(0.0, done - begun - decode_s - track_s)
        stages = Stages(frame.queued - frame.arrived, begun - frame.queued, transit_s, decode_s, track_s)
        result = {
            "type": "result",
            "seq": frame.seq,
            "ts": frame.ts,
            "size": self.size,
            "dropped": dropped,
            "region": self.region,
            "targets": wiring.targets(state["rows"], state.get("maps")),
            "timing": {
                "queue_ms": round((stages.receive + stages.queue + transit_s) * 1e3, 3),
                "decode_ms": round(decode_s * 1e3, 3),
                "track_ms": round(track_s * 1e3, 3),
            },
        }
        answers = [refused and _refusal(refused) for refused in state["answers"]]
        return result, answers, stages

    async def control(self, control: Mapping[str, Any]) -> tuple[dict[str, Any] | None, list[int] | None]:
        """Add, correct or remove a target on the newest frame: the target, if it is there, and the region."""
        async with self._turn:
            try:
                state = await self._call("control", control, changes=True)
            except ProblemError as refused:
                if refused.code == "full-frame-needed":
                    self.region = refused.members["region"]
                raise
            self._take(state)
            if control["type"] != "remove":
                self.trajectory.amend(self.rows, self.region)
        row = next((row for row in state["rows"] if row[0] == state["target"]), None)
        return row and wiring.target(row), self.region

    async def snapshot(self) -> bytes | memoryview:
        """The session as bytes, between two frames; they are not signed."""
        front = {"label": self.options.label, "idle_timeout_s": self.options.idle_timeout_s}
        async with self._turn:
            data: bytes | memoryview = await self._call("snapshot", {"front": front})
        return data

    def revive(self) -> None:
        """Have the state restored, now that its lane is lost."""
        if not self._reviving:
            self._reviving = True
            self._later(self._revive())

    def move(self, lane: int) -> None:
        """Have the session go on in another lane, between two frames; they wait meanwhile."""
        self._later(self._move(lane))

    async def park(self) -> None:
        """Finish what is in work and keep the state as it is then. Raises as every operation."""
        if self._restoring and not self.lane.replay_log.operations:
            return  # nothing has happened since the state was kept, and a lane may be long in coming
        async with self._turn:
            if self.lane.replay_log.operations and not self.ended:
                await self._guarded(self.lane.checkpoint("stop"))

    async def settled(self) -> None:
        """Wait until nothing is in work."""
        async with self._turn:
            pass

    def target_maps(self) -> list[dict[str, Any]]:
        """The targets as the newest frame left them."""
        return wiring.targets(self.rows)

    def _take(self, state: dict[str, Any]) -> None:
        self.seq, self.size, self.region, self.rows = (
            state["seq"],
            state["size"],
            state["region"],
            state["rows"],
        )

    def _later(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _checkpoint(self) -> None:
        # After the frame was answered, and between two.
        with suppress(ProblemError):
            async with self._turn:
                if not self.ended and (reason := self.lane.checkpoint_due):
                    await self._keep(reason)

    async def _revive(self) -> None:
        try:
            async with self._turn:
                if not self.ended and not self.lane.has_lane:
                    self._restoring = True
                    await self._guarded(self.lane.recover())
        except ProblemError as refused:
            log.warning("session not restored", session=self.id, code=refused.code)
        finally:
            self._reviving = self._restoring = False
            self.touch()

    async def _move(self, lane: int) -> None:
        try:
            async with self._turn:
                if not self.ended and self.lane.has_lane:
                    await self._keep("move")
                    await self._guarded(self.lane.move(lane))
        except ProblemError as refused:
            log.warning("session not moved", session=self.id, lane=lane, code=refused.code)

    async def _keep(self, reason: str) -> None:
        await self._guarded(self.lane.checkpoint(reason))
        self._on_saveable(self)

    async def _call(self, op: str, args: Mapping[str, Any], data: bytes = b"", *, changes: bool = False) -> Any:
        if self.ended:
            raise session_gone(self.ended)
        try:
            code, value = await self._guarded(self.lane.call(Operation(op, args, data), changes=changes))
        finally:
            self.touch()
        if changes and self.lane.checkpoint_due and not self._tasks:
            self._later(self._checkpoint())
        if code == "internal":
            log.error("fault in a lane", session=self.id, op=op, fault=value[0])
            raise ProblemError("internal", "the fault is logged under the request id")
        if code is not None:
            raise _refusal([code, *value])
        return value

    async def _guarded(self, work: Awaitable[T]) -> T:
        try:
            return await work
        except LaneLost as lost:
            raise session_gone(self.ended or "lost") from lost
        except Poisoned as poisoned:
            log.error("session is poisoned", session=self.id, fault=str(poisoned))
            if self.lane.replay_log.checkpoint is not None:
                self._on_poison(self, str(poisoned))
                raise session_gone("lost", str(poisoned)) from poisoned
            # It has not begun.
            code, detail = ("deadline-exceeded", "took too long") if poisoned.late else ("internal", "ended its worker")
            raise ProblemError(code, f"the operation {detail}") from poisoned


def _refusal(told: list[Any]) -> ProblemError:
    code, detail, members = told
    return ProblemError(code, detail, **members)
