"""The lanes of this machine: places keys, replaces lanes that die, ends lanes that hang or grow too large."""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import multiprocessing
import time
from collections.abc import AsyncIterator, Awaitable
from multiprocessing import forkserver
from typing import Any

from ..protocol.enums import LaneLoss
from .balance import Rebalancer, RecentUsage
from .interface import (
    AtCapacity,
    Buffers,
    KeysLost,
    LaneCrowded,
    LaneEvent,
    LaneLost,
    LaneReady,
    LaneStatus,
    LaneUsage,
    Place,
)
from .limits import LaneLimits
from .process import LaneProcess
from .usage import cpu_s, rss_bytes

WATCH_EVERY_S = 0.1
BALANCE_EVERY_S = 0.5
STOP_S = 2.0
# A lane that lives shorter than this counts as crashing in a row with the one before. The first two of a row are
# replaced at once; from then on each doubles the wait.
STEADY_S = 2.0
PATIENCE = 2
FIRST_WAIT_S, LONGEST_WAIT_S = 0.1, 10.0


class LanePool:
    """``count`` worker processes with ``keys_per_lane`` places each (see :class:`~.interface.Lanes`)."""

    def __init__(
        self,
        count: int,
        keys_per_lane: int,
        limits: LaneLimits,
        *,
        deadline_s: float,
        start_timeout_s: float,
        max_rss_bytes: int,
    ) -> None:
        self._keys_per_lane = keys_per_lane
        self._limits = limits
        self._deadline_s = deadline_s
        self._start_timeout_s = start_timeout_s
        self._max_rss_bytes = max_rss_bytes
        self._usage = RecentUsage(time.monotonic())
        self._rebalancer = Rebalancer()
        self._lanes: list[LaneProcess] = [self._new(number) for number in range(count)]
        self._crashes = [0] * count
        self._homes: dict[str, LaneProcess] = {}
        # Keys without a lane: the number of the lane in which a place is kept for each, and why its lane was lost.
        self._displaced: dict[str, tuple[int, str]] = {}
        self._changed = asyncio.Event()
        self._events: asyncio.Queue[LaneEvent] = asyncio.Queue()
        self._tasks: set[asyncio.Task[None]] = set()
        self._context = multiprocessing.get_context("forkserver")
        self._stopping = False

    async def start(self) -> None:
        """Begin to start all lanes."""
        self._context.set_forkserver_preload(["service.lanes.forkserver"])
        # Without this, an interpreter that ends without stop() would wait for its workers for ever.
        atexit.register(self._kill_all)
        for lane in self._lanes:
            self._spawn(self._begin(lane))
        self._spawn(self._watch())
        self._spawn(self._balance())

    async def stop(self) -> None:
        """End all lanes."""
        self._stopping = True
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await asyncio.gather(*(lane.stop(STOP_S) for lane in self._lanes))
        atexit.unregister(self._kill_all)

    def reserve(self, key: str, owner: str) -> None:
        """Give ``key`` a place in the lane with the most time to spare. Raises AtCapacity."""
        lane = self._idlest()
        if lane is None:
            raise AtCapacity
        self._settle(key, owner, lane)

    def move(self, key: str, lane: int) -> bool:
        """Move the place of ``key`` to that lane; return False if it has none free."""
        before, after = self._homes.get(key), self._lanes[lane]
        if before is None or before is after or after not in self._with_room():
            return False
        owner = before.keys[key]
        before.forget(key)
        self._settle(key, owner, after)
        self._changed.set()
        return True

    async def regain(self, key: str, owner: str) -> Place:
        """Wait for a place for a key whose lane was lost, or that comes from another process. Raises LaneLost.

        A place is kept in the lane that replaces the lost one, so that load stays spread. If that lane keeps dying, or
        has become full, any other lane serves.
        """
        if key in self._homes:
            return Place(self._homes[key].number, "")
        work = self._work()
        self._displaced.setdefault(key, (min(range(len(self._lanes)), key=work.__getitem__), LaneLoss.RESTART))
        while True:
            number, cause = self._displaced[key]
            lane: LaneProcess | None = self._lanes[number]
            if not (lane and lane.ready and len(lane.keys) < self._keys_per_lane):
                full = self._load()[number] > self._keys_per_lane
                lane = self._idlest() if full or self._failing(number) else None
            if lane is not None:
                del self._displaced[key]
                self._settle(key, owner, lane)
                return Place(lane.number, cause)
            self._changed.clear()
            await self._changed.wait()
            if key not in self._displaced:
                raise LaneLost(LaneLoss.RELEASED)

    def holds(self, key: str) -> bool:
        """Return whether ``key`` has a place in a lane."""
        return key in self._homes

    def call(self, key: str, request: Buffers) -> Awaitable[bytes | memoryview]:
        """Do one operation in the key's lane and return the reply. Raises LaneLost."""
        lane = self._homes.get(key)
        if lane is None:
            raise LaneLost(LaneLoss.ABSENT)
        return lane.call(key, request)

    def release(self, key: str) -> None:
        """Free the key's place."""
        lane = self._homes.pop(key, None)
        self._displaced.pop(key, None)
        self._usage.forget(key)
        if lane is not None:
            lane.forget(key)
        self._changed.set()

    async def events(self) -> AsyncIterator[LaneEvent]:
        """Yield what happens to lanes; for one reader."""
        while True:
            yield await self._events.get()

    def status(self) -> list[LaneStatus]:
        """Return the state of every lane."""
        return [
            LaneStatus(lane.number, lane.ready, self._failing(lane.number), len(lane.keys), lane.versions)
            for lane in self._lanes
        ]

    def usage(self) -> list[LaneUsage]:
        """Return what every lane uses."""
        return [LaneUsage(lane.number, rss_bytes(lane.pid), cpu_s(lane.pid)) for lane in self._lanes]

    def _load(self) -> list[int]:
        """Return the number of keys of each lane, including those that wait for it."""
        load = [len(lane.keys) for lane in self._lanes]
        for number, _ in self._displaced.values():
            load[number] += 1
        return load

    def _work(self) -> list[float]:
        """Return the work of each lane: the sum of what its keys have used of late.

        Each key counts for at least half of an even share, because one that pauses, or has not begun, may need it soon.
        """
        least = 0.5 / self._keys_per_lane
        work = [least * keys for keys in self._load()]
        for key, part in self._usage.parts():
            if key in self._homes:
                work[self._homes[key].number] += max(0.0, part - least)
        return work

    def _with_room(self) -> list[LaneProcess]:
        """Return the lanes that are ready and have a place for which no key waits."""
        load = self._load()
        return [lane for lane in self._lanes if lane.ready and load[lane.number] < self._keys_per_lane]

    def _idlest(self) -> LaneProcess | None:
        """Return the lane with room that has the least work."""
        work = self._work()
        return min(self._with_room(), key=lambda lane: work[lane.number], default=None)

    def _settle(self, key: str, owner: str, lane: LaneProcess) -> None:
        lane.keys[key] = owner
        self._homes[key] = lane

    def _failing(self, number: int) -> bool:
        """Return whether the lane of this number has died again and again, and the newest has not yet proved itself."""
        lane = self._lanes[number]
        return self._crashes[number] > PATIENCE and not (lane.ready and lane.lasted_s() > STEADY_S)

    def _new(self, number: int) -> LaneProcess:
        return LaneProcess(number, on_ready=self._ready, on_lost=self._lost, on_used=self._usage.add)

    def _spawn(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _begin(self, lane: LaneProcess, wait_s: float = 0.0) -> None:
        await asyncio.sleep(wait_s)
        try:
            # Here, because the fork server dies with the thread that starts it (see die_with_parent).
            forkserver.ensure_running()
            await lane.start(self._context, self._limits)
        except (OSError, EOFError):
            lane.kill()
            self._lost(lane, LaneLoss.START)

    def _ready(self, lane: LaneProcess) -> None:
        self._events.put_nowait(LaneReady(lane.number, lane.confined))
        self._changed.set()

    def _lost(self, lane: LaneProcess, cause: LaneLoss) -> None:
        if self._stopping:
            return
        lane.kill()  # a worker whose socket is gone may still be computing
        for key in lane.keys:
            del self._homes[key]
            self._displaced[key] = lane.number, cause
        self._events.put_nowait(KeysLost(lane.number, cause, tuple(lane.keys)))
        steady = bool(lane.versions) and lane.lasted_s() > STEADY_S
        self._crashes[lane.number] = 0 if steady else self._crashes[lane.number] + 1
        crashes = self._crashes[lane.number]
        wait_s = min(FIRST_WAIT_S * 2 ** (crashes - PATIENCE), LONGEST_WAIT_S) if crashes > PATIENCE else 0.0
        self._lanes[lane.number] = self._new(lane.number)
        self._spawn(self._begin(self._lanes[lane.number], wait_s))
        self._changed.set()

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(WATCH_EVERY_S)
            for lane in self._lanes:
                if lane.overdue_s() > self._deadline_s:
                    lane.kill(LaneLoss.HUNG)
                elif rss_bytes(lane.pid) > self._max_rss_bytes:
                    lane.kill(LaneLoss.MEMORY)
                elif lane.pid and not lane.ready and lane.lasted_s() > self._start_timeout_s:
                    lane.kill()

    async def _balance(self) -> None:
        """Announce which key should move while one lane is full and another idle."""
        while True:
            await asyncio.sleep(BALANCE_EVERY_S)
            now = time.monotonic()
            self._usage.update(now)
            parts: list[dict[str, float]] = [{} for _ in self._lanes]
            for key, part in self._usage.parts():
                if key in self._homes:
                    parts[self._homes[key].number][key] = part
            room = [lane.number for lane in self._with_room() if not self._failing(lane.number)]
            if (chosen := self._rebalancer.choose(parts, room, now)) is not None:
                self._events.put_nowait(LaneCrowded(*chosen))

    def _kill_all(self) -> None:
        for lane in self._lanes:
            with contextlib.suppress(OSError):
                lane.kill()
