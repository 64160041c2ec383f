"""The parts that the commands share: how they start, how they fail, how they print."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mfcmt_core.cli import UsageError, main
from service.client import ClientError
from service.load.own import ServerFailed

ROOT = Path(__file__).parents[2]

Tell = Callable[[str], None]
"""Called with the name of each step, for a progress bar."""


@dataclass(frozen=True, slots=True)
class Findings:
    """The results of a run: as lines of text, as data for JSON, and whether all is well."""

    lines: Iterable[str]
    data: Any
    passed: bool


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add the argument that all commands have."""
    parser.add_argument("--json", action="store_true", help="print JSON")


def check_range(name: str, value: float, least: float, most: float) -> None:
    """Raise UsageError if an argument's value is not between ``least`` and ``most``."""
    if not least <= value <= most:
        raise UsageError(f"{name} is from {least:.9g} to {most:.9g}")


def finish(command: str, as_json: bool, work: Callable[[], Findings]) -> int:
    """Do ``work``, print its findings and return the exit code: 0 if all is well, else 1."""
    try:
        found = work()
    except (ClientError, ServerFailed, TimeoutError) as failed:
        print(f"mfcmt {command}: {failed}", file=sys.stderr)
        return 1
    print(json.dumps(found.data) if as_json else "\n".join(found.lines))
    return 0 if found.passed else 1


def start(command: str) -> None:
    """Run ``mfcmt command`` with the arguments of this process, and end it with the exit code."""
    sys.exit(main([command, *sys.argv[1:]]))
