"""What a frame costs the front: ``python -m tests.service.front.cost [--beside CHECKOUT]``.

Microseconds of processor time of the front's process for each whole VGA frame that is sent alone and answered, by
subprotocol: the median of short rounds, and the least of them, which is nearest to that of a machine with nothing else
to do; then calls in Python and in C, and how often the process waits. The lanes are canned (see ``canned_lane``). With
``--beside`` the front of another checkout of this project takes turns with this one, round by round, so that the ratio
holds on a busy machine.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from service.client import AsyncClient, AsyncSession, Frame, Result
from service.client.connection import Connection, Protocol
from service.load.clips import Clip, sample
from service.load.own import OwnServer
from service.load.run import run_loop

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
PROTOCOLS: tuple[Protocol, ...] = ("mfcmt.v1.msgpack", "mfcmt.v1.json")
FRAMES, COUNTED = 100, 100
PRELUDE = """
import sys
sys.path[:0] = [{checkout!r}, {here!r}]
import canned_lane
canned_lane.install()
"""


def front_of(checkout: Path) -> OwnServer:
    """Return the server of a checkout, with canned lanes."""
    return OwnServer(lanes=1, prelude=PRELUDE.format(checkout=str(checkout), here=str(HERE)))


def spent_ns(pid: int) -> int:
    """Return the processor time of all threads of a process, in nanoseconds."""
    return sum(int(each.read_text().split()[0]) for each in Path(f"/proc/{pid}/task").glob("*/schedstat"))


def switches(pid: int) -> int:
    """Return how often the main thread of a process has waited."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("voluntary_ctxt_switches"))


async def _open(url: str, clip: Clip, protocol: Protocol) -> tuple[AsyncClient, AsyncSession, Connection]:
    client = AsyncClient(url)
    session = await client.create(clip.frame(0), clip.box)
    connection = await Connection.open(client.address, session.id, mode="lossless", protocol=protocol)
    await connection.receive()
    return client, session, connection


async def _send(connection: Connection, clip: Clip, count: int) -> None:
    for index in range(count):
        await connection.send_frame(Frame(clip.frame(1 + index)))
        assert isinstance(await connection.receive(), Result)


async def _round(server: OwnServer, clip: Clip, protocol: Protocol) -> tuple[float, float]:
    """Return the microseconds and the context switches of a frame."""
    client, session, connection = await _open(server.url, clip, protocol)
    await _send(connection, clip, FRAMES // 10)
    before, waited = spent_ns(server.pid), switches(server.pid)
    await _send(connection, clip, FRAMES)
    spent, waits = spent_ns(server.pid) - before, switches(server.pid) - waited
    await connection.close()
    await session.close()
    await client.aclose()
    return spent / FRAMES / 1e3, waits / FRAMES


async def _count(server: OwnServer, clip: Clip, protocol: Protocol) -> dict[str, float]:
    """Return the number of calls of a frame, by kind and function."""
    client, session, connection = await _open(server.url, clip, protocol)
    await _send(connection, clip, COUNTED)
    os.kill(server.pid, signal.SIGUSR1)
    await _send(connection, clip, COUNTED)
    os.kill(server.pid, signal.SIGUSR1)
    await _send(connection, clip, 1)
    await connection.close()
    await session.close()
    await client.aclose()
    counted = list(_counted(server.log))[-1]
    return {name: number / COUNTED for name, number in counted.items()}


def _counted(log: str) -> Iterator[dict[str, int]]:
    for line in log.splitlines():
        if line.startswith('{"counted"'):
            yield json.loads(line)["counted"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--beside", type=Path, help="another checkout to compare with")
    parser.add_argument("--rounds", type=int, default=25, help="rounds of 100 frames")
    parser.add_argument("--calls", type=int, default=0, metavar="N", help="also list the N functions called most")
    args = parser.parse_args()
    clip = sample(60)
    checkouts = {"here": ROOT} | ({"beside": args.beside.resolve()} if args.beside else {})
    print(f"{'':<20}{'front':<10}{'us a frame':>12}{'least':>8}{'calls':>8}{'C calls':>9}{'waits':>8}{'ratio':>8}")
    with ExitStack() as stack:
        servers = {name: stack.enter_context(front_of(path)) for name, path in checkouts.items()}
        for protocol in PROTOCOLS:
            rounds: dict[str, list[tuple[float, float]]] = {name: [] for name in servers}
            for turn in range(args.rounds):
                for name in list(servers)[:: 1 if turn % 2 else -1]:
                    rounds[name].append(run_loop(_round(servers[name], clip, protocol)))
            for name, server in servers.items():
                calls = run_loop(_count(server, clip, protocol))
                _line(protocol, name, rounds, calls)
                listed = sorted((call for call in calls.items() if ":" in call[0]), key=lambda call: -call[1])
                for function, number in listed[: args.calls]:
                    print(f"    {number:6.2f} {function}")


def _line(protocol: str, name: str, rounds: dict[str, list[tuple[float, float]]], calls: dict[str, Any]) -> None:
    spent, waits = (statistics.median(values) for values in zip(*rounds[name], strict=True))
    least = min(one for one, _ in rounds[name])
    beside = rounds.get("beside", rounds["here"])
    ratio = statistics.median(one[0] / other[0] for one, other in zip(rounds[name], beside, strict=True))
    counted = f"{least:8.1f}{calls['call']:8.0f}{calls.get('c_call', 0):9.0f}{waits:8.2f}{ratio:8.2f}"
    print(f"{protocol:<20}{name:<10}{spent:12.1f}{counted}", flush=True)


if __name__ == "__main__":
    main()
