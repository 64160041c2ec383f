"""``mfcmt siege``: attack a service of one's own while a neighbour streams, and measure the neighbour's wait."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable

from mfcmt_core.cli import UsageError
from service.load.clips import sample

from ..command import Findings, add_json, finish
from .attacks import ATTACKS, Attack
from .outcome import BOUND_BYTES, MAX_RATIO, MAX_STALL_S, UNFELT_S, Outcome
from .run import Plan, siege

USUAL, SHORT = Plan(rounds=3, seconds=4.0, past=1500), Plan(rounds=1, seconds=1.0, past=200)
SIZE = (160, 120)
CLIP_FRAMES = 30


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add("--short", action="store_true", help="attack for one second each, after one undisturbed second")
    add("--only", metavar="TEXT", help="only the attacks whose name contains TEXT; default: all")
    add("--list", action="store_true", help="print the attacks and do nothing")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Return 0 if every target was met, else 1."""
    attacks = [attack for attack in ATTACKS if (args.only or "") in attack.name]
    if not attacks:
        raise UsageError(f"--only: no attack has {args.only!r} in its name; --list prints them all")
    if args.list:
        print("\n".join(_described(attack) for attack in attacks))
        return 0

    def work() -> Findings:
        clip = sample(CLIP_FRAMES).resized(SIZE)
        outcomes = siege(clip, SHORT if args.short else USUAL, attacks, _tell)
        missed = any(outcome.missed() for outcome in outcomes)
        return Findings(_lines(outcomes), [outcome.as_dict() for outcome in outcomes], not missed)

    return finish("siege", args.json, work)


def _tell(step: str) -> None:
    print(f"... {step}", file=sys.stderr)


def _described(attack: Attack) -> str:
    return f"{attack.name}: {attack.connections} connections {'with' if attack.keyed else 'without'} a key"


def _lines(outcomes: list[Outcome]) -> Iterable[str]:
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
