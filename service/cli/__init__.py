"""The service's subcommands of ``mfcmt``."""

from __future__ import annotations

import importlib
import sys
from functools import partial
from pathlib import Path
from typing import cast

from mfcmt_core.cli import Command, Subcommand, UsageError

REPOSITORY = Path(__file__).parents[2]
TOOLS = {
    "soak": "work for a long time and check that memory stays flat",
    "fuzz": "send a service bad inputs and count wrong answers",
    "siege": "attack a service of one's own while a neighbour streams, and measure the neighbour's wait",
    "chaos": "kill, stop and bloat a service under load and count lost results",
}
"""Commands that try the service hard. Their code is in the repository and not in the package."""


def load_tool(name: str) -> Command:
    """Return the module of a tool of the repository. Raises UsageError where there is no repository."""
    if not (REPOSITORY / "tests" / "tools" / name).is_dir():
        raise UsageError(f"not in the installed package; in a clone of the project run python -m tests.tools.{name}")
    if str(REPOSITORY) not in sys.path:
        sys.path.insert(0, str(REPOSITORY))
    return cast(Command, importlib.import_module(f"tests.tools.{name}"))


COMMANDS = {
    "serve": Subcommand.of("service.cli.serve", "run the tracking service"),
    "health": Subcommand.of("service.cli.health", "check a running service on this machine: exit code 0 or 1"),
    "load": Subcommand.of("service.cli.load", "drive a service with real frames and measure it"),
    "demo": Subcommand.of("service.cli.demo", "start a service and open its page with the sample clip"),
    **{name: Subcommand(summary, partial(load_tool, name)) for name, summary in TOOLS.items()},
}
