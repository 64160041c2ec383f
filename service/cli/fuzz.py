"""``mfcmt fuzz``: send a service of one's own bad inputs and count wrong answers."""

from __future__ import annotations

import argparse
import json
import sys

from mfcmt_core.cli import UsageError
from mfcmt_core.cli.progress import Progress

from ..load.clips import sample
from ..load.fuzz import KINDS, Fuzz, Tally
from ..load.own import OwnServer, ServerFailed
from ..load.run import run_loop

MOST = 1_000_000
SIZE = (160, 120)
CLIP_FRAMES = 3


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add("--count", type=int, default=2000, metavar="N", help="inputs of each of five kinds (2000)")
    add("--seed", type=int, default=1, metavar="N", help="what the inputs follow from (1)")
    add("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """0 if every answer was right, else 1."""
    if not 0 < args.count <= MOST:
        raise UsageError(f"--count is above 0 and at most {MOST}")
    clip = sample(CLIP_FRAMES).resized(SIZE)
    try:
        with OwnServer(lanes=1, signing_keys="a-secret-of-the-fuzz-run", log_level="warning") as server:
            with Progress(KINDS * args.count, "inputs") as bar:
                tallies = run_loop(Fuzz(server.url, clip, args.seed).run(args.count, bar.step))
            faults = [line for line in server.log.splitlines() if "Traceback" in line or '"error"' in line]
            restarts = [line for line in server.log.splitlines() if "lane lost" in line]
    except ServerFailed as failed:
        print(f"mfcmt fuzz: {failed}", file=sys.stderr)
        return 1
    wrong = sum(len(tally.wrong) for tally in tallies.values()) + len(faults) + len(restarts)
    print(_json(tallies, faults, restarts) if args.json else _text(tallies, faults, restarts))
    return 1 if wrong else 0


def _text(tallies: dict[str, Tally], faults: list[str], restarts: list[str]) -> str:
    lines = []
    for name, tally in tallies.items():
        codes = ", ".join(f"{code} {count}" for code, count in tally.refused.most_common())
        told = f"{tally.tried:7} tried, {tally.valid:5} still valid, {len(tally.wrong)} wrong"
        lines.append(f"{name:<9}{told}\n           {codes}")
        lines += [f"           WRONG {fault[:300]}" for fault in tally.wrong[:5]]
    lines += [f"faults in the log: {len(faults)}; lanes lost: {len(restarts)}", *faults[:5]]
    tried = sum(tally.tried for tally in tallies.values())
    wrong = sum(len(tally.wrong) for tally in tallies.values())
    lines.append(f"bad inputs tried: {tried}; wrong answers: {wrong} of {tried}")
    return "\n".join(lines)


def _json(tallies: dict[str, Tally], faults: list[str], restarts: list[str]) -> str:
    kinds = {
        name: {"tried": t.tried, "valid": t.valid, "refused": t.refused, "wrong": t.wrong}
        for name, t in tallies.items()
    }
    return json.dumps({"kinds": kinds, "faults": faults, "lanes_lost": len(restarts)})
