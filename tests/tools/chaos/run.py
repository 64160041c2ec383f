"""Causes faults at random moments under lossless streams, and counts results that are lost or differ, and the time."""

from __future__ import annotations

import asyncio
import os
import random
import signal
import tempfile
import time
from bisect import bisect_right
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from service.client import AsyncClient, AsyncSession, Frame, Problem, Result, Resumed
from service.load.clips import Clip
from service.load.own import OwnServer
from service.load.usage import server_processes

from ..command import Tell

MIB = 1 << 20
LANE_FAULTS = ("SIGKILL", "SIGSTOP", "memory")
RESTARTS = ("SIGTERM", "kill -9")
# Between two faults, from the moment all streams go on.
PAUSE_S = (0.5, 2.5)
# Idle time of the sessions: all are older when the service is first restarted, and yet in use.
IDLE_S = 10.0
# How long a stream may be without a result before the run is given up.
PATIENCE_S = 60.0
DEADLINE_S = 2.0
# A result that comes sooner after a fault was on its way: no lane is replaced in this time.
UNDER_WAY_S = 0.015
MAX_LANE_BYTES = 640 * MIB
# Makes lanes grow at a signal; it is only ever in the path of a server that is started here.
GROW = """
import signal
held = []
signal.signal(signal.SIGUSR1, lambda *_: held.append(b"grow" * (16 << 20)))
"""


@dataclass(frozen=True, slots=True)
class Plan:
    """``faults`` of lanes, then ``restarts`` of each kind, under ``sessions`` streams of ``fps``; by ``seed``."""

    sessions: int
    fps: float
    lanes: int
    faults: int
    restarts: int
    seed: int


@dataclass(slots=True)
class Stream:
    """The frames and results of one client, by index; times in seconds of the monotonic clock."""

    sent_at: list[float] = field(default_factory=list)
    answered_at: dict[int, float] = field(default_factory=dict)
    said: dict[int, object] = field(default_factory=dict)
    refused: Counter[str] = field(default_factory=Counter)
    forgotten: list[int] = field(default_factory=list)
    seq: int = 0
    session: str = ""

    def went_on(self, moment: float) -> bool:
        """Whether a frame that was sent after ``moment`` is answered."""
        return bisect_right(self.sent_at, moment) in self.answered_at

    def next_result(self, moment: float) -> float:
        """When the first result came after ``moment``, if it cannot have been under way then."""
        return min(at for at in reversed(self.answered_at.values()) if at > moment + UNDER_WAY_S)

    def take(self, result: Result) -> None:
        """A frame is answered."""
        index = int(result.ts or 0)
        self.seq = result.seq
        self.answered_at[index] = time.monotonic()
        self.said[index] = (result.targets, result.region, result.size)

    def refuse(self, problem: Problem) -> None:
        """A frame is refused."""
        self.refused[problem.code] += 1

    def resume(self, resumed: Resumed) -> None:
        """The stream goes on; with a loss, after how many results that the session has forgotten."""
        if resumed.lost_after is not None:
            self.forgotten.append(self.seq - resumed.lost_after)


@dataclass(frozen=True, slots=True)
class Report:
    """What came of it; of each kind of fault how many, and the ``seconds`` to the next result of each stream hit."""

    plan: Plan
    faults: dict[str, int]
    seconds: dict[str, list[float]]
    frames: int
    lost: int
    refused: dict[str, int]
    compared: int
    differ: int
    forgotten: list[int]
    age_s: float
    """Of the youngest session when the service was first restarted; 0 if it was not."""

    @property
    def flawless(self) -> bool:
        """True if no result is missing or differs."""
        return not (self.lost or self.refused or self.differ)

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def chaos(clip: Clip, plan: Plan, say: Tell) -> Report:
    """Run ``plan`` against a new server; ``say`` is called with each step."""
    with tempfile.TemporaryDirectory(prefix="mfcmt-chaos-") as folder:
        (Path(folder) / "sitecustomize.py").write_text(GROW)
        with OwnServer(
            environment={"PYTHONPATH": os.pathsep.join(filter(None, (folder, os.environ.get("PYTHONPATH"))))},
            state_dir=Path(folder) / "state",
            lanes=plan.lanes,
            max_sessions_per_lane=plan.sessions,
            operation_deadline_s=DEADLINE_S,
            max_lane_rss_bytes=MAX_LANE_BYTES,
        ) as server:
            return asyncio.run(_Run(server, clip, plan, say).run())


class _Run:
    def __init__(self, server: OwnServer, clip: Clip, plan: Plan, say: Tell) -> None:
        self._server, self._clip, self._plan, self._say = server, clip, plan, say
        self._random = random.Random(plan.seed)
        self._streams = [Stream() for _ in range(plan.sessions)]
        self._seconds: dict[str, list[float]] = {kind: [] for kind in (*LANE_FAULTS, *RESTARTS)}
        self._faults: Counter[str] = Counter()
        self._over = False
        self._created = 0.0
        self._age_s = 0.0

    async def run(self) -> Report:
        async with AsyncExitStack() as stack:
            client = await stack.enter_async_context(AsyncClient(self._server.url))
            sessions = [
                await client.create(self._clip.frame(0), self._clip.box, idle_timeout_s=IDLE_S) for _ in self._streams
            ]
            self._created = time.monotonic()
            driving = [
                asyncio.create_task(self._drive(session, stream))
                for session, stream in zip(sessions, self._streams, strict=True)
            ]
            try:
                sure = await self._inject()
                self._over = True
                await asyncio.gather(*driving)
            finally:
                for task in driving:
                    task.cancel()
            self._say("the undisturbed run")
            undisturbed = Stream()
            twin = await client.create(self._clip.frame(0), self._clip.box)
            most = max(len(stream.sent_at) for stream in self._streams)
            frames = (Frame(self._clip.frame(1 + index), ts=index) for index in range(most))
            async for result in twin.stream(frames, mode="lossless"):
                undisturbed.take(result)
        return self._report(undisturbed, sure)

    async def _inject(self) -> list[int]:
        """Inject all; how many frames of each stream were answered before the first ``kill -9`` of the service."""
        for number in range(self._plan.faults):
            await self._pause()
            # All kinds in turn, each time in another order.
            kinds = random.Random(f"{self._plan.seed} {number // len(LANE_FAULTS)}").sample(LANE_FAULTS, 3)
            await self._fault(kinds[number % len(LANE_FAULTS)])
        if self._plan.restarts:
            await self._outlive_idle_time()
        for _ in range(self._plan.restarts):
            await self._pause()
            await self._restart("SIGTERM", signal.SIGTERM)
        await self._pause()
        sure = [len(stream.said) for stream in self._streams]
        for _ in range(self._plan.restarts):
            await self._restart("kill -9", signal.SIGKILL)
            await self._pause()
        return sure

    async def _fault(self, kind: str) -> None:
        lanes = {role: pid for role, pid in server_processes(self._server.pid).items() if role.startswith("lane")}
        role, pid = self._random.choice(sorted(lanes.items()))
        logged = len(self._server.log)
        if kind == "memory":
            await self._grow(pid)
        else:
            os.kill(pid, signal.Signals[kind])
        begun = time.monotonic()
        await self._until_all_go_on(begun)
        restored = self._server.log[logged:]
        self._count(kind, begun, role, [stream for stream in self._streams if stream.session in restored])

    async def _grow(self, pid: int) -> None:
        try:
            while True:
                os.kill(pid, signal.SIGUSR1)
                await asyncio.sleep(0.01)
        except ProcessLookupError:
            pass

    async def _restart(self, kind: str, how: signal.Signals) -> None:
        begun = time.monotonic()
        os.kill(self._server.pid, how)
        while self._server.exit_code is None:
            await asyncio.sleep(0.01)
        gone = time.monotonic()
        await asyncio.to_thread(self._server.start)
        await self._until_all_go_on(gone)
        self._count(kind, begun, "the service", self._streams, gone)

    async def _outlive_idle_time(self) -> None:
        await asyncio.sleep(max(0.0, self._created + IDLE_S + 1 - time.monotonic()))
        self._age_s = time.monotonic() - self._created

    async def _pause(self) -> None:
        await asyncio.sleep(self._random.uniform(*PAUSE_S))

    async def _until_all_go_on(self, begun: float) -> None:
        give_up = time.monotonic() + PATIENCE_S
        while not all(stream.went_on(begun) for stream in self._streams):
            if time.monotonic() > give_up:
                raise TimeoutError(f"a stream has had no result for {PATIENCE_S:g} s")
            await asyncio.sleep(0.005)

    def _count(self, kind: str, begun: float, where: str, hit: list[Stream], gone: float | None = None) -> None:
        """``gone`` is when the old process, which may still have answered, was no more."""
        seconds = [stream.next_result(gone or begun) - begun for stream in hit]
        self._faults[kind] += 1
        self._seconds[kind] += seconds
        self._say(f"{kind} on {where}: {len(hit)} streams go on, the last after {max(seconds, default=0):.3f} s")

    async def _drive(self, session: AsyncSession, stream: Stream) -> None:
        stream.session = session.id
        results = session.stream(
            self._source(stream),
            mode="lossless",
            on_refused=stream.refuse,
            on_resumed=stream.resume,
            reconnect_for_s=PATIENCE_S,
        )
        async for result in results:
            stream.take(result)

    async def _source(self, stream: Stream) -> AsyncIterator[Frame]:
        while not self._over:
            index = len(stream.sent_at)
            stream.sent_at.append(time.monotonic())
            yield Frame(self._clip.frame(1 + index), ts=index)
            await asyncio.sleep(max(0.0, stream.sent_at[index] + 1 / self._plan.fps - time.monotonic()))

    def _report(self, undisturbed: Stream, sure: list[int]) -> Report:
        frames = sum(len(stream.sent_at) for stream in self._streams)
        refused: Counter[str] = Counter()
        for stream in self._streams:
            refused.update(stream.refused)
        compared = [
            (said, undisturbed.said.get(index))
            for stream, count in zip(self._streams, sure, strict=True)
            for index, said in stream.said.items()
            if index < count
        ]
        return Report(
            self._plan,
            dict(self._faults),
            {kind: seconds for kind, seconds in self._seconds.items() if seconds},
            frames,
            frames - sum(len(stream.said) for stream in self._streams) - refused.total(),
            dict(refused),
            len(compared),
            sum(said != wanted for said, wanted in compared),
            [count for stream in self._streams for count in stream.forgotten],
            self._age_s,
        )
