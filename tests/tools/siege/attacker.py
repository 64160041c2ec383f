"""The attacker, a separate process: ``python -m tests.tools.siege.attacker NAME``.

It reads the ground as JSON from its input, prints ``ready``, reads a number of seconds, attacks for that long, and
prints the answers by their codes.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import sys
from collections import Counter
from typing import Any

from .attacks import ATTACKS, Attack
from .traffic import HEAVY_BYTES, Ground, padded

# Runs behind the service and its neighbour, so that the measurement is not of the competition for cores.
NICENESS = 5
ANSWER = re.compile(rb'HTTP/1\.1 (\d{3})|"code":"([a-z-]+)"')
CLOSE = re.compile(rb"\x88[\x02-\x7d](\x03[\xe8-\xff]|\x11[\x00-\xff])", re.S)
PAUSE_S = 0.005
READ_BYTES = 1 << 18


class Attacker:
    """All connections of one attack."""

    def __init__(self, attack: Attack, ground: Ground) -> None:
        self._attack, self._ground = attack, ground
        self.answers: Counter[str] = Counter()

    async def run(self, seconds: float) -> None:
        """Attack for ``seconds``."""
        connections = [self._connection(number) for number in range(self._attack.connections)]
        try:
            async with asyncio.timeout(seconds):
                await asyncio.gather(*connections)
        except TimeoutError:
            pass

    async def _connection(self, number: int) -> None:
        while True:
            writer = None
            try:
                reader, writer = await asyncio.open_connection("127.0.0.1", self._ground.port, limit=READ_BYTES)
                await self._besiege(reader, writer, number)
            except (OSError, asyncio.IncompleteReadError):
                self.answers["cut"] += 1
            finally:
                if writer is not None and not writer.transport.is_closing():
                    writer.transport.abort()
            if not self._attack.again:
                await asyncio.Event().wait()
            await asyncio.sleep(PAUSE_S)

    async def _besiege(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, number: int) -> None:
        attack, ground = self._attack, self._ground
        opening, pouring = attack.opening(ground, number), attack.pouring(ground, number)
        writer.write(opening)
        if attack.stream:
            head = await reader.readuntil(b"\r\n\r\n")
            self._count(head)
        if attack.deaf:
            await self._pour(writer, pouring)
            await asyncio.Event().wait()
        if attack.lockstep or not pouring:
            while opening or attack.stream:
                if not await self._hear(reader):
                    return
                writer.write(pouring)
            return
        hearing = asyncio.ensure_future(self._hear_all(reader))
        try:
            while not hearing.done():
                await self._pour(writer, pouring)
        finally:
            hearing.cancel()

    async def _pour(self, writer: asyncio.StreamWriter, data: bytes) -> None:
        writer.write(data)
        await writer.drain()
        await asyncio.sleep(0)

    async def _hear_all(self, reader: asyncio.StreamReader) -> None:
        while await self._hear(reader):
            pass

    async def _hear(self, reader: asyncio.StreamReader) -> bool:
        data = await reader.read(READ_BYTES)
        self._count(data)
        return bool(data)

    def _count(self, data: bytes) -> None:
        for status, code in ANSWER.findall(data):
            if code or not status.startswith((b"4", b"5")):
                self.answers[(code or status).decode()] += 1
        for code in CLOSE.findall(data):
            self.answers[str(int.from_bytes(code, "big"))] += 1


def main() -> None:
    """Run the attack, as the module says."""
    os.nice(NICENESS)
    attack = next(attack for attack in ATTACKS if attack.name == sys.argv[1])
    given: dict[str, Any] = json.loads(sys.stdin.readline())
    given["image"] = bytes.fromhex(given["image"])
    given["heavy"] = padded(given["image"], HEAVY_BYTES)
    attacker = Attacker(attack, Ground(**given))
    _say("ready")
    seconds = float(sys.stdin.readline())
    asyncio.run(attacker.run(seconds))
    _say(json.dumps({"answers": attacker.answers}))


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
