"""Clients that send frames at a rate, or as fast as answers come, and time each answer."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, field

from ..client import AsyncClient, AsyncSession, ConnectionLost, Frame, Mode, Problem, Ready, Result
from ..client.connection import Connection, Protocol
from .clips import Clip

# Time for the answers to the last frames.
TAIL_S = 5.0


@dataclass(slots=True)
class Tally:
    """The figures of one client; times in milliseconds."""

    sent: int = 0
    dropped: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    sent_bytes: int = 0
    seconds: float = 0.0
    round_trips_ms: list[float] = field(default_factory=list)
    queue_ms: list[float] = field(default_factory=list)
    decode_ms: list[float] = field(default_factory=list)
    track_ms: list[float] = field(default_factory=list)

    @property
    def answered(self) -> int:
        return len(self.round_trips_ms)

    def add(self, result: Result, round_trip_s: float) -> None:
        self.round_trips_ms.append(round_trip_s * 1e3)
        self.dropped += result.dropped
        if result.timing is not None:
            self.queue_ms.append(result.timing.queue_ms)
            self.decode_ms.append(result.timing.decode_ms)
            self.track_ms.append(result.timing.track_ms)


@dataclass(frozen=True, slots=True)
class Pace:
    """The pace of a client: ``fps`` frames/s, or with 0 the next frame as soon as there is credit."""

    seconds: float
    fps: float = 0.0
    mode: Mode = "lossless"
    in_flight: int | None = None
    protocol: Protocol = "mfcmt.v1.msgpack"


async def drive(client: AsyncClient, session: AsyncSession, clip: Clip, pace: Pace) -> Tally:
    """Stream ``clip`` to ``session`` for ``pace.seconds`` and return the figures. Raises Problem, ConnectionLost."""
    connection = await Connection.open(client.address, session.id, mode=pace.mode, protocol=pace.protocol)
    try:
        return await _Driver(connection, clip, pace).run()
    finally:
        await connection.close()


class _Driver:
    def __init__(self, connection: Connection, clip: Clip, pace: Pace) -> None:
        self._connection = connection
        self._clip = clip
        self._pace = pace
        self._tally = Tally()
        self._sent_at: dict[int, float] = {}
        self._answered = asyncio.Event()

    async def run(self) -> Tally:
        ready = await self._connection.receive()
        if not isinstance(ready, Ready):
            raise ready if isinstance(ready, Problem) else ConnectionLost("the stream began without ready")
        room = min(self._pace.in_flight or math.inf, ready.credit or math.inf)
        receiving = asyncio.create_task(self._receive())
        receiving.add_done_callback(lambda _: self._answered.set())
        start = time.perf_counter()
        try:
            await self._send(ready.next_seq, room, start, receiving)
            self._tally.seconds = time.perf_counter() - start
            await self._drain()
        finally:
            receiving.cancel()
        return self._tally

    async def _send(self, first: int, room: float, start: float, receiving: asyncio.Task[None]) -> None:
        pace, tally = self._pace, self._tally
        while (now := time.perf_counter()) - start < pace.seconds:
            if receiving.done():
                receiving.result()
            if pace.fps:
                due = start + tally.sent / pace.fps
                if due > now:
                    await asyncio.sleep(due - now)
            elif len(self._sent_at) >= room:
                self._answered.clear()
                await asyncio.wait_for(self._answered.wait(), TAIL_S)
                continue
            seq = first + tally.sent
            data = self._clip.frame(1 + tally.sent)
            self._sent_at[seq] = time.perf_counter()
            await self._connection.send_frame(Frame(data, seq=seq))
            tally.sent += 1
            tally.sent_bytes += len(data)

    async def _receive(self) -> None:
        while True:
            message = await self._connection.receive()
            now = time.perf_counter()
            if isinstance(message, Result):
                self._tally.add(message, now - self._sent_at[message.seq])
                self._forget(message.seq)
            elif isinstance(message, Problem):
                self._tally.refused[message.code] = self._tally.refused.get(message.code, 0) + 1
                self._sent_at.pop(-1 if message.seq is None else message.seq, None)
            self._answered.set()

    def _forget(self, seq: int) -> None:
        """Forget the frames up to an answered number: in `latest` the older ones were dropped and get no answer."""
        for older in [older for older in self._sent_at if older <= seq]:
            del self._sent_at[older]

    async def _drain(self) -> None:
        give_up = time.perf_counter() + TAIL_S
        while self._sent_at and time.perf_counter() < give_up:
            self._answered.clear()
            try:
                await asyncio.wait_for(self._answered.wait(), give_up - time.perf_counter())
            except TimeoutError:
                return


def quantile(values: Iterable[float], share: float) -> float:
    """Return the value below which ``share`` of ``values`` lie; NaN if there are none."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))] if ordered else math.nan
