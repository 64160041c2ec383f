"""``mfcmt fuzz``: send a service of one's own bad inputs and count wrong answers."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from mfcmt_core.cli.progress import Progress
from service.load.clips import sample
from service.load.own import OwnServer
from service.load.run import run_loop

from ..command import Findings, add_json, check_range, finish
from .run import KINDS, Fuzz, Tally

MOST = 1_000_000
SIZE = (160, 120)
CLIP_FRAMES = 3


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add("--count", type=int, default=2000, metavar="N", help="inputs of each of five kinds (2000)")
    add("--seed", type=int, default=1, metavar="N", help="seed of the inputs (1)")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Return 0 if every answer was right, else 1."""
    check_range("--count", args.count, 1, MOST)

    def work() -> Findings:
        clip = sample(CLIP_FRAMES).resized(SIZE)
        with OwnServer(lanes=1, signing_keys="a-secret-of-the-fuzz-run", log_level="warning") as server:
            with Progress(KINDS * args.count, "inputs") as bar:
                tallies = run_loop(Fuzz(server.url, clip, args.seed).run(args.count, bar.step))
            log = server.log.splitlines()
        faults = [line for line in log if "Traceback" in line or '"error"' in line]
        lost = sum("lane lost" in line for line in log)
        kinds = {
            name: {"tried": t.tried, "valid": t.valid, "refused": t.refused, "wrong": t.wrong}
            for name, t in tallies.items()
        }
        wrong = sum(len(tally.wrong) for tally in tallies.values())
        data = {"kinds": kinds, "faults": faults, "lanes_lost": lost}
        return Findings(_lines(tallies, faults, lost, wrong), data, not (wrong or faults or lost))

    return finish("fuzz", args.json, work)


def _lines(tallies: dict[str, Tally], faults: list[str], lost: int, wrong: int) -> Iterable[str]:
    for name, tally in tallies.items():
        yield f"{name:<9}{tally.tried:7} tried, {tally.valid:5} still valid, {len(tally.wrong)} wrong"
        yield "           " + ", ".join(f"{code} {count}" for code, count in tally.refused.most_common())
        yield from (f"           WRONG {fault[:300]}" for fault in tally.wrong[:5])
    yield f"faults in the log: {len(faults)}; lanes lost: {lost}"
    yield from faults[:5]
    tried = sum(tally.tried for tally in tallies.values())
    yield f"bad inputs tried: {tried}; wrong answers: {wrong} of {tried}"
