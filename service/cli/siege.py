"""``mfcmt siege``: attack a service of one's own, beside a neighbour, and see what the neighbour notices."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable

from mfcmt_core.cli import UsageError

from ..client import ClientError
from ..load.clips import sample
from ..load.own import ServerFailed
from ..load.siege import BOUND_BYTES, MAX_RATIO, MAX_STALL_S, UNFELT_S, Outcome, Plan, siege
from ..load.siege_attacks import ATTACKS, Attack

USUAL, SHORT = Plan(rounds=3, seconds=4.0, past=1500), Plan(rounds=1, seconds=1.0, past=200)
SIZE = (160, 120)
CLIP_FRAMES = 30


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add("--short", action="store_true", help="a second of each attack, and as long undisturbed")
    add("--only", metavar="TEXT", help="the attacks whose name has this in it; default: all")
    add("--list", action="store_true", help="print the attacks and do nothing")
    add("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """0 if every target was met, else 1."""
    attacks = [attack for attack in ATTACKS if (args.only or "") in attack.name]
    if not attacks:
        raise UsageError(f"--only: no attack has {args.only!r} in its name; --list prints them all")
    if args.list:
        print("\n".join(_described(attack) for attack in attacks))
        return 0
    clip = sample(CLIP_FRAMES).resized(SIZE)
    try:
        outcomes = siege(clip, SHORT if args.short else USUAL, attacks, _tell)
    except (ClientError, ServerFailed, TimeoutError) as failed:
        print(f"mfcmt siege: {failed}", file=sys.stderr)
        return 1
    print(json.dumps([outcome.as_dict() for outcome in outcomes]) if args.json else "\n".join(_told(outcomes)))
    return 1 if any(outcome.missed() for outcome in outcomes) else 0


def _tell(step: str) -> None:
    print(f"... {step}", file=sys.stderr)


def _described(attack: Attack) -> str:
    return f"{attack.name}: {attack.connections} connections {'with' if attack.keyed else 'without'} a key"


def _told(outcomes: list[Outcome]) -> Iterable[str]:
    yield "                                                  neighbour's wait, ms   worst  longest    MB more"
    yield "attack                                            p99: calm  besieged  (any) stall, ms  front lanes  answers"
    for one in outcomes:
        answers = ", ".join(f"{code} {count}" for code, count in one.answers.most_common(6)) or "none"
        yield (
            f"{one.attack:<50}{one.calm.p99_s * 1e3:9.1f}{one.besieged.p99_s * 1e3:10.1f}"
            f"{one.besieged.worst_s * 1e3:7.0f}{one.stall_s * 1e3:10.1f}"
            f"{one.front_bytes / 1e6:7.0f}{one.lanes_bytes / 1e6:6.0f}  {answers}"
        )
        for missed in one.missed():
            yield f"    MISSED {missed}"
    highest = max(outcomes, key=lambda one: one.stall_s)
    yield (
        f"targets: a stall of at most {MAX_STALL_S * 1e3:.0f} ms of processor time, the neighbour's p99 at most "
        f"{MAX_RATIO:g} times as long or below {UNFELT_S * 1e3:.0f} ms, the front at most "
        f"{BOUND_BYTES / 1e6:.0f} MB above its rest"
    )
    yield (
        f"longest stall {highest.stall_s * 1e3:.1f} ms ({highest.attack}); the front at most "
        f"{max(one.front_above_rest_bytes for one in outcomes) / 1e6:.0f} MB above its rest; "
        f"attacks that missed a target: {sum(bool(one.missed()) for one in outcomes)} of {len(outcomes)}"
    )
