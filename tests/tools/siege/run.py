"""Attacks a server one way after the other, while a neighbour streams and a probe asks whether the server is alive.

What is measured: how long the neighbour waits, beside an undisturbed stretch of the same length just before; how
long the event loop works at a stretch, in processor time, which other work on the machine does not change; what
the front and the lanes hold at most.
"""

from __future__ import annotations

import asyncio
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.client import AsyncClient, AsyncSession, Frame, Ready, Result
from service.client.address import Address
from service.client.connection import Connection
from service.lanes.usage import rss_bytes
from service.load.clips import Clip
from service.load.own import OwnServer
from service.load.run import run_loop
from service.load.usage import server_processes

from ..command import ROOT, Tell
from .attacks import Attack
from .outcome import RECOVERY_BYTES, ROOM_BYTES, Outcome, Waits
from .traffic import HEAVY_BYTES, MIB, padded

FPS = 30.0
PROBES_PER_S = 10.0
MEMORY_EVERY_S = 0.05
# An attacker's sessions, and its frames with many targets for a long past.
SESSIONS, PAST_TARGETS = 14, 16
BESIEGED = "the-key-of-the-besieged-neighbour"
BESIEGER = "the-key-of-the-one-who-besieges"
PATIENCE_S = 30.0
# One or two frames of the neighbour may be under way at any time.
NEIGHBOURS_BYTES = 100_000
SETTINGS: dict[str, Any] = {
    "lanes": 1,
    "max_sessions_per_lane": 64,
    "api_keys": f"{BESIEGED},{BESIEGER}",
    "signing_keys": "a-secret-of-the-siege",
    "max_upload_bytes": ROOM_BYTES,
    "max_recovery_bytes": RECOVERY_BYTES,
    # The besieger's sessions outlive the attacks that do not use them.
    "idle_timeout_s": 3600.0,
    "attached_idle_timeout_s": 3600.0,
}
GONE = ("session-gone", "session-not-found")
# Runs in the server before it starts: beside the watch of the loop's lag, it appends a line to a file for every stretch
# that the loop's thread worked without a timer's turn. A line is the monotonic time and the processor time, in seconds.
# A timer every 2 ms costs more than a service should pay.
NOTE_STRETCHES = """
import asyncio, time
from service.observability.lag import Lag
watch = Lag.watch
async def watch_and_note(self):
    watching = asyncio.ensure_future(watch(self))
    with open({file!r}, "a", buffering=1) as lines:
        used = time.thread_time()
        while True:
            await asyncio.sleep(0.002)
            before, used = used, time.thread_time()
            if used - before > 0.005:
                print(f"{{time.monotonic():.6f}} {{used - before:.6f}}", file=lines)
Lag.watch = watch_and_note
"""


@dataclass(frozen=True, slots=True)
class Plan:
    """``rounds`` of ``seconds`` undisturbed and as long besieged; ``past`` frames of a session's long past."""

    rounds: int
    seconds: float
    past: int


class Siege:
    """A server, its neighbour and its besieger's sessions; made by :func:`siege`."""

    def __init__(self, server: OwnServer, clip: Clip, plan: Plan, stretches: Path) -> None:
        self._server, self._clip, self._plan, self._stretches = server, clip, plan, stretches
        self._processes = server_processes(server.pid)
        self._rest_bytes = self._front_bytes()
        self._ground: dict[str, Any] = {}
        self._waits: Waits | None = None
        self._neighbour: AsyncSession
        self._log_read = 0

    async def run(self, attacks: Sequence[Attack], tell: Tell) -> list[Outcome]:
        """Make all ``attacks``, one by one, and return their outcomes."""
        outcomes = []
        async with (
            AsyncClient(self._server.url, key=BESIEGED) as ours,
            AsyncClient(self._server.url, key=BESIEGER) as theirs,
        ):
            self._neighbour = await ours.create(self._clip.frames[0], self._clip.box)
            tell("the besieger makes its sessions")
            await self._prepare(theirs)
            self._rest_bytes = self._front_bytes()
            watching = asyncio.ensure_future(self._probe())
            streaming = asyncio.ensure_future(self._stream())
            for attack in attacks:
                tell(attack.name)
                outcomes.append(await self._besiege(attack))
                outcomes[-1].damage += await self._damage(ours, streaming)
            for task in (watching, streaming):
                task.cancel()
            await asyncio.gather(watching, streaming, return_exceptions=True)
        return outcomes

    async def _prepare(self, theirs: AsyncClient) -> None:
        first, box = self._clip.frames[0], self._clip.box
        sessions = [await theirs.create(first, box) for _ in range(SESSIONS)]
        past = await theirs.create(first, boxes=[box] * PAST_TARGETS)
        frames = (self._clip.frame(1 + n) for n in range(self._plan.past))
        async for _ in past.stream(frames, mode="lossless"):
            pass
        large = await theirs.create(padded(first, HEAVY_BYTES), box)
        self._ground = {
            "port": self._server.port,
            "key": BESIEGER,
            "sessions": [session.id for session in sessions],
            "past": past.id,
            "large": large.id,
            "image": first.hex(),
        }

    async def _besiege(self, attack: Attack) -> Outcome:
        outcome, plan = Outcome(attack.name), self._plan
        before = self._memory()
        for _ in range(plan.rounds):
            process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-m",
                "tests.tools.siege.attacker",
                attack.name,
                cwd=ROOT,
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
            )
            assert process.stdin is not None
            assert process.stdout is not None
            try:
                process.stdin.write(json.dumps(self._ground).encode() + b"\n")
                await process.stdout.readline()
                calm, besieged = Waits(), Waits()
                outcome.rounds.append((calm, besieged))
                self._waits = calm
                await asyncio.sleep(plan.seconds)
                self._waits = besieged
                began = time.monotonic()
                process.stdin.write(b"%g\n" % plan.seconds)
                watching = asyncio.ensure_future(self._watch_memory(outcome, before))
                heard = await asyncio.wait_for(process.stdout.readline(), plan.seconds + PATIENCE_S)
                await asyncio.sleep(0.2)
                watching.cancel()
            finally:
                self._waits = None
                with suppress(ProcessLookupError):
                    process.kill()
                await process.wait()
            outcome.stall_s = max(outcome.stall_s, self._longest_stretch(began))
            outcome.answers.update(json.loads(heard)["answers"])
        if gone := sum(outcome.answers[code] for code in GONE):
            outcome.damage.append(f"the attack met sessions that had ended ({gone} answers), so it tried nothing")
        return outcome

    async def _stream(self) -> None:
        """Stream as the neighbour: a frame every 1/FPS seconds, however late the answers are."""
        sent_at: dict[int, tuple[float, Waits | None]] = {}
        address = Address.of(self._server.url, BESIEGED, PATIENCE_S, PATIENCE_S)
        connection = await Connection.open(address, self._neighbour.id, mode="lossless")
        ready = await connection.receive()
        assert isinstance(ready, Ready)

        async def hear() -> None:
            while True:
                message = await connection.receive()
                if isinstance(message, Result):
                    sent, waits = sent_at.pop(message.seq)
                    if waits is not None:
                        waits.results.append(time.perf_counter() - sent)
                else:
                    raise RuntimeError(f"the neighbour was heard {message}")

        async def say() -> None:
            begun = time.perf_counter()
            seq, due = ready.next_seq, 0
            while True:
                await asyncio.sleep(max(0.0, begun + due / FPS - time.perf_counter()))
                if len(sent_at) < (ready.credit or 1):
                    sent_at[seq] = begun + due / FPS, self._waits
                    await connection.send_frame(Frame(self._clip.frame(1 + seq), seq=seq))
                    seq += 1
                due += 1

        await asyncio.gather(hear(), say())

    async def _probe(self) -> None:
        while True:
            began, waits = time.perf_counter(), self._waits
            reader, writer = await asyncio.open_connection("127.0.0.1", self._server.port)
            writer.write(b"GET /livez HTTP/1.1\r\nHost: service\r\nConnection: close\r\n\r\n")
            await reader.readline()
            took_s = time.perf_counter() - began
            writer.close()
            if waits is not None:
                waits.probes.append(took_s)
            await asyncio.sleep(max(0.0, 1 / PROBES_PER_S - took_s))

    async def _watch_memory(self, outcome: Outcome, before: tuple[int, int]) -> None:
        while True:
            front, lanes = self._memory()
            outcome.front_bytes = max(outcome.front_bytes, front - before[0])
            outcome.lanes_bytes = max(outcome.lanes_bytes, lanes - before[1])
            outcome.front_above_rest_bytes = max(outcome.front_above_rest_bytes, front - self._rest_bytes)
            await asyncio.sleep(MEMORY_EVERY_S)

    def _memory(self) -> tuple[int, int]:
        lanes = sum(rss_bytes(pid) for role, pid in self._processes.items() if role.startswith("lane"))
        return self._front_bytes(), lanes

    def _front_bytes(self) -> int:
        return rss_bytes(self._server.pid)

    def _longest_stretch(self, since: float) -> float:
        lines = (line.split() for line in self._stretches.read_text().splitlines())
        return max((float(stretch) for at, stretch in lines if float(at) >= since), default=0.0)

    async def _damage(self, ours: AsyncClient, streaming: asyncio.Future[None]) -> list[str]:
        """Return what an attack has damaged."""
        damage = []
        if streaming.done():
            damage.append(f"the neighbour's stream ended: {streaming.exception()}")
        if self._server.exit_code is not None:
            damage.append(f"the server ended with {self._server.exit_code}")
        elif server_processes(self._server.pid) != self._processes:
            damage.append("a lane was lost")
            self._processes = server_processes(self._server.pid)
        log = self._server.log
        faults = [line for line in log[self._log_read :].splitlines() if "Traceback" in line or '"error"' in line]
        damage += [f"a fault in the log: {line[:200]} ... {line[-200:]}" for line in faults[:2]]
        self._log_read = len(log)
        held = await self._still_held()
        if held > NEIGHBOURS_BYTES:
            damage.append(f"{held / 1e6:.1f} MB are held for nobody")
        try:
            async with asyncio.timeout(PATIENCE_S), await ours.create(self._clip.frames[0], self._clip.box) as session:
                await session.track(self._clip.frames[1])
        except Exception as failed:
            damage.append(f"a new session does not work: {failed!r}")
        return damage

    async def _still_held(self) -> int:
        """Return the bytes under way by the service's own count, once they are few or the patience ends."""
        give_up = time.monotonic() + PATIENCE_S
        held = NEIGHBOURS_BYTES + 1
        while held > NEIGHBOURS_BYTES and time.monotonic() < give_up:
            await asyncio.sleep(0.1)
            with suppress(OSError):
                reader, writer = await asyncio.open_connection("127.0.0.1", self._server.port, limit=MIB)
                writer.write(b"GET /metrics HTTP/1.1\r\nHost: service\r\nConnection: close\r\n\r\n")
                text = await reader.read()
                writer.close()
                held = next(
                    int(float(line.split()[1]))
                    for line in text.splitlines()
                    if line.startswith(b"mfcmt_under_way_bytes ")
                )
        return held


def siege(clip: Clip, plan: Plan, attacks: Sequence[Attack], tell: Tell) -> list[Outcome]:
    """Start a server, attack it and return the outcomes."""
    with tempfile.TemporaryDirectory(prefix="mfcmt-siege-") as folder:
        stretches = Path(folder) / "stretches"
        with OwnServer(prelude=NOTE_STRETCHES.format(file=str(stretches)), **SETTINGS) as server:
            outcomes: list[Outcome] = run_loop(Siege(server, clip, plan, stretches).run(attacks, tell))
    return outcomes
