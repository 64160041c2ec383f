"""Faults of nodes and of their Redis, under lossless streams of both clients through a real HAProxy."""

from __future__ import annotations

import asyncio
import json
import os
import random
import shutil
import signal
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import redis

from mfcmt_core.cli import UsageError
from service.client import AsyncClient, ClientError, Frame, Problem, Result, Resumed
from service.load.clips import Clip
from service.load.own import OwnServer, free_port
from tests.service.cluster.nodes import KEY, haproxy
from tests.service.cluster.redis_server import RedisServer
from tests.service.live.cable import Cable

from ..command import ROOT, Tell

NAMES = ("node-1", "node-2", "node-3")
FAULTS = ("kill", "stop", "drain", "partition", "Redis restarted", "Redis emptied")
PAUSE_S = 1.0
# Longer than a lease, so that the node's sessions are taken up by others meanwhile.
STOP_S = 8.0
PARTITION_S = 5.0
# After this time an emptied Redis has all sessions again (a node's beat and MFCMT_STORE_EVERY_S); a node that is killed
# sooner takes what is not there yet with it.
SAVED_AGAIN_S = 8.0
REDIS_AWAY_S = 2.0
PATIENCE_S = 90.0
SCRIPT = ROOT / "tests/service/jsclient/paced.mjs"


@dataclass(frozen=True, slots=True)
class ClusterPlan:
    """``rounds`` of all ``FAULTS`` in an order by ``seed``; each third of the ``sessions`` streams is JavaScript's."""

    sessions: int
    fps: float
    rounds: int
    seed: int
    faults: tuple[str, ...] = FAULTS


@dataclass(slots=True)
class Told:
    """What one client sent and got, by the frame's index; times in seconds of the monotonic clock."""

    sent_at: list[float] = field(default_factory=list)
    said: dict[int, list[Any]] = field(default_factory=dict)
    answered_at: list[float] = field(default_factory=list)
    doubled: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    forgotten_from: int | None = None
    """The first frame whose result may differ, since a node's loss made its session forget."""
    error: str | None = None

    def take(self, index: int, targets: list[Any]) -> None:
        """A frame is answered."""
        self.doubled += index in self.said
        self.said[index] = targets
        self.answered_at.append(time.monotonic())

    def forget(self) -> None:
        """The client is told that its session forgot some of the frames so far."""
        if self.forgotten_from is None:
            self.forgotten_from = len(self.said)

    def went_on(self, moment: float) -> bool:
        """Whether a frame that was sent after ``moment`` is answered, or the stream is lost."""
        first = next((index for index, at in enumerate(self.sent_at) if at > moment), None)
        return self.error is not None or (first is not None and first in self.said)

    @property
    def longest_pause_s(self) -> float:
        return max((b - a for a, b in zip(self.answered_at, self.answered_at[1:], strict=False)), default=0.0)


@dataclass(frozen=True, slots=True)
class ClusterReport:
    """What came of it; ``pauses`` are the longest of any stream from each fault to the next one."""

    plan: ClusterPlan
    frames: int
    lost: int
    doubled: int
    refused: dict[str, int]
    compared: int
    differ: int
    sessions_lost: list[str]
    pauses: dict[str, list[float]]
    forgotten: int

    @property
    def flawless(self) -> bool:
        """True if no result is missing, doubled or other than undisturbed, and no session is lost."""
        return not (self.lost or self.doubled or self.refused or self.differ or self.sessions_lost)

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def cluster_chaos(clip: Clip, plan: ClusterPlan, say: Tell) -> ClusterReport:
    """Run ``plan`` against new nodes; ``say`` is called with each step. Raises UsageError if a program is missing."""
    for program in ("haproxy", "node"):
        if shutil.which(program) is None:
            raise UsageError(f"--cluster needs {program}")
    return asyncio.run(_Cluster(clip, plan, say).run())


class _Cluster:
    def __init__(self, clip: Clip, plan: ClusterPlan, say: Tell) -> None:
        self._clip, self._plan, self._say = clip, plan, say
        self._random = random.Random(plan.seed)
        self._nodes: list[OwnServer] = []
        self._cables: list[Cable] = []
        self._told = [Told() for _ in range(plan.sessions)]
        self._over = asyncio.Event()
        self._pauses: dict[str, list[float]] = {}
        self._url = ""

    async def run(self) -> ClusterReport:
        with ExitStack() as held, tempfile.TemporaryDirectory(prefix="mfcmt-chaos-") as made:
            folder = Path(made)
            self._redis = held.enter_context(RedisServer())
            for at, frame in enumerate(self._clip.frames):
                (folder / f"{at}.jpg").write_bytes(frame)
            async with AsyncExitStack() as open_:
                await self._start(folder, held, open_)
                streams = [
                    asyncio.create_task(self._javascript(told, folder) if at % 3 == 0 else self._python(told))
                    for at, told in enumerate(self._told)
                ]
                try:
                    await self._until(lambda: all(told.said or told.error for told in self._told))
                    for _ in range(self._plan.rounds):
                        for fault in self._random.sample(self._plan.faults, len(self._plan.faults)):
                            await self._inject(fault)
                    self._over.set()
                    await asyncio.gather(*streams)
                finally:
                    for stream in streams:
                        stream.cancel()
                self._say("the undisturbed run")
                undisturbed = Told()
                await self._python(undisturbed, max(len(told.sent_at) for told in self._told))
        return self._report(undisturbed)

    async def _start(self, folder: Path, held: ExitStack, open_: AsyncExitStack) -> None:
        """Start three nodes, each with a cable to Redis, and HAProxy before them."""
        port = free_port()
        self._url = f"http://127.0.0.1:{port}"
        for name in NAMES:
            cable = await open_.enter_async_context(Cable(self._redis.port))
            node = OwnServer(
                lanes=1,
                port=free_port(),
                api_keys=KEY,
                signing_keys="the-same-for-all-nodes-0123456789",
                store=f"redis://{cable.url.removeprefix('http://')}/0",
                node=name,
                node_url=f"{self._url}/{name}",
                max_sessions_per_lane=2 * self._plan.sessions,
                operation_deadline_s=60,
            )
            self._cables.append(cable)
            self._nodes.append(node)
            await asyncio.to_thread(held.enter_context, node)
        command = haproxy(folder, port, self._nodes)
        proxy = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        held.callback(proxy.wait)
        held.callback(proxy.terminate)
        async with AsyncClient(self._url, key=KEY) as client:
            await _answers(client)

    async def _inject(self, fault: str) -> None:
        await asyncio.sleep(PAUSE_S)
        begun = time.monotonic()
        at = self._random.randrange(len(NAMES))
        async with _FAULTS[fault](self, at):
            pass
        # Each stream goes on after the fault is over.
        over = time.monotonic()
        await self._until(lambda: all(told.went_on(over) for told in self._told))
        pause = max(
            (
                later - earlier
                for told in self._told
                for earlier, later in zip(told.answered_at, told.answered_at[1:], strict=False)
                if later > begun
            ),
            default=0.0,
        )
        self._pauses.setdefault(fault, []).append(pause)
        self._say(f"{fault}: the longest pause was {pause:.1f} s")

    @asynccontextmanager
    async def kill(self, at: int) -> AsyncIterator[None]:
        """A node is killed, and starts anew when its sessions go on elsewhere."""
        os.kill(self._nodes[at].pid, signal.SIGKILL)
        begun = time.monotonic()
        yield
        await self._until(lambda: all(told.went_on(begun) for told in self._told))
        await asyncio.to_thread(self._nodes[at].start)

    @asynccontextmanager
    async def stop(self, at: int) -> AsyncIterator[None]:
        """A node stands still for longer than its lease, and comes back."""
        os.kill(self._nodes[at].pid, signal.SIGSTOP)
        yield
        await asyncio.sleep(STOP_S)
        os.kill(self._nodes[at].pid, signal.SIGCONT)

    @asynccontextmanager
    async def drain(self, at: int) -> AsyncIterator[None]:
        """A node is asked to end, as in a rolling update, and starts anew."""
        yield
        await asyncio.to_thread(self._nodes[at].stop)
        await asyncio.to_thread(self._nodes[at].start)

    @asynccontextmanager
    async def partition(self, at: int) -> AsyncIterator[None]:
        """Nothing passes between a node and Redis, and neither is told."""
        self._cables[at].mute = True
        self._cables[at].go_dead()
        yield
        await asyncio.sleep(PARTITION_S)
        self._cables[at].mute = False
        self._cables[at].cut()

    @asynccontextmanager
    async def restart_redis(self, _: int) -> AsyncIterator[None]:
        """Redis is killed, and comes back with what it had on disk."""
        await asyncio.to_thread(self._on_redis, lambda client: client.save())
        yield
        await self._without_redis()

    @asynccontextmanager
    async def empty_redis(self, _: int) -> AsyncIterator[None]:
        """Redis is killed, and comes back with nothing."""
        folder = await asyncio.to_thread(self._on_redis, lambda client: client.config_get("dir")["dir"])
        (Path(folder) / "dump.rdb").unlink(missing_ok=True)
        yield
        await self._without_redis()
        await asyncio.sleep(SAVED_AGAIN_S)

    async def _without_redis(self) -> None:
        self._redis.kill()
        for cable in self._cables:
            cable.cut()
        await asyncio.sleep(REDIS_AWAY_S)
        await asyncio.to_thread(self._redis.start)

    def _on_redis(self, work: Callable[[Any], Any]) -> Any:
        with redis.Redis(port=self._redis.port, decode_responses=True) as client:
            return work(client)

    async def _until(self, condition: Callable[[], bool]) -> None:
        give_up = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > give_up:
                raise TimeoutError(f"a stream has had no result for {PATIENCE_S:g} s")
            await asyncio.sleep(0.02)

    async def _python(self, told: Told, count: int | None = None) -> None:
        """Stream until the run is over, or ``count`` frames as fast as they are answered."""

        async def frames() -> AsyncIterator[Frame]:
            while not self._over.is_set() if count is None else len(told.sent_at) < count:
                index = len(told.sent_at)
                told.sent_at.append(time.monotonic())
                yield Frame(self._clip.frame(1 + index), ts=index)
                await asyncio.sleep(1 / self._plan.fps if count is None else 0)

        def resumed(message: Resumed) -> None:
            if message.lost_after is not None:
                told.forget()

        def refused(problem: Problem) -> None:
            told.refused[problem.code] += 1

        try:
            async with AsyncClient(self._url, key=KEY, ping_interval_s=3) as client:
                session = await client.create(self._clip.frame(0), self._clip.box)
                hear: dict[str, Any] = {"on_resumed": resumed, "on_refused": refused}
                async for result in session.stream(frames(), mode="lossless", reconnect_for_s=PATIENCE_S, **hear):
                    told.take(int(result.ts or 0), _plain(result))
        except ClientError as failed:
            told.error = str(failed)

    async def _javascript(self, told: Told, folder: Path) -> None:
        """Stream as :meth:`_python` does, from Node."""
        given = {"url": self._url, "key": KEY, "folder": str(folder), "count": len(self._clip.frames)}
        given |= {"box": self._clip.box, "fps": self._plan.fps, "patience_s": PATIENCE_S}
        pipe = asyncio.subprocess.PIPE
        process = await asyncio.create_subprocess_exec(
            "node", str(SCRIPT), json.dumps(given), stdin=pipe, stdout=pipe, limit=1 << 20
        )
        assert process.stdin is not None
        assert process.stdout is not None
        stdin = process.stdin
        ending = asyncio.create_task(self._over.wait())
        ending.add_done_callback(lambda _: stdin.close())
        try:
            async for line in process.stdout:
                match json.loads(line):
                    case {"sent": _}:
                        told.sent_at.append(time.monotonic())
                    case {"index": index, "targets": targets}:
                        told.take(index, targets)
                    case {"lost_after": _}:
                        told.forget()
                    case {"refused": code}:
                        told.refused[code] += 1
                    case {"error": error}:
                        told.error = error
            await process.wait()
        finally:
            ending.cancel()
            if process.returncode is None:
                process.kill()

    def _report(self, undisturbed: Told) -> ClusterReport:
        refused = sum((told.refused for told in self._told), Counter[str]())
        frames = sum(len(told.sent_at) for told in self._told)
        compared = [
            (targets, undisturbed.said.get(index))
            for told in self._told
            for index, targets in told.said.items()
            if told.forgotten_from is None or index < told.forgotten_from
        ]
        return ClusterReport(
            self._plan,
            frames,
            frames - sum(len(told.said) for told in self._told) - refused.total(),
            sum(told.doubled for told in self._told),
            dict(refused),
            len(compared),
            sum(targets != wanted for targets, wanted in compared),
            [told.error for told in self._told if told.error is not None],
            self._pauses,
            sum(told.forgotten_from is not None for told in self._told),
        )


def _plain(result: Result) -> list[Any]:
    """Return the targets as the JavaScript client's script prints them."""
    return [[*target.box, str(target.status)] for target in result.targets]


async def _answers(client: AsyncClient) -> None:
    """Wait until HAProxy has found the nodes ready."""
    give_up = time.monotonic() + PATIENCE_S
    while True:
        try:
            await client.capabilities()
        except ClientError:
            if time.monotonic() > give_up:
                raise
            await asyncio.sleep(0.1)
        else:
            return


_FAULTS: dict[str, Callable[[_Cluster, int], Any]] = {
    "kill": _Cluster.kill,
    "stop": _Cluster.stop,
    "drain": _Cluster.drain,
    "partition": _Cluster.partition,
    "Redis restarted": _Cluster.restart_redis,
    "Redis emptied": _Cluster.empty_redis,
}
