"""The ``mfcmt`` command: each subcommand is a module that is imported when it runs."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from typing import NoReturn, Protocol, cast

from .. import __version__
from ..errors import MFCMTError

COMMANDS = {
    "track": ("mfcmt_core.cli.track", "follow a box through images, a video or a camera"),
    "eval": ("mfcmt_core.cli.evaluate", "score trackers on OTB: OPE, TRE, SRE"),
    "bench": ("mfcmt_core.cli.bench", "milliseconds a frame, stage by stage, alone or beside other trackers"),
    "warmup": ("mfcmt_core.cli.warmup", "compile the kernels for this CPU and keep them on disk"),
    "serve": ("service.cli.serve", "run the tracking service"),
    "health": ("service.cli.health", "ask a running service on this machine how it is: exit code 0 or 1"),
    "load": ("service.cli.load", "drive a service with real frames and measure it"),
    "soak": ("service.cli.soak", "work for long and see that memory stays flat"),
    "fuzz": ("service.cli.fuzz", "send a service bad inputs and count wrong answers"),
    "siege": ("service.cli.siege", "attack a service of one's own beside a neighbour and see who notices"),
    "chaos": ("service.cli.chaos", "kill, stop and bloat a service under load and count what is lost"),
    "demo": ("service.cli.demo", "open the page with the sample clip, on a service of its own"),
}


class Command(Protocol):
    """What a subcommand's module defines."""

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""

    def run(self, args: argparse.Namespace) -> int:
        """Do the work; the exit code. Raises :class:`UsageError` for arguments that do not fit."""


class UsageError(Exception):
    """The arguments do not fit together or name what is not there: one line, exit code 2."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """One line instead of the usage."""
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def main(argv: list[str] | None = None) -> int:
    """Entry point of the console script: 0 done, 1 failed, 2 bad arguments, 130 interrupted."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # before numpy is loaded: its matrices are small, and threads only wait
    argv = sys.argv[1:] if argv is None else argv
    parser = _Parser(prog="mfcmt", description="Track a target through video on a CPU.")
    parser.add_argument("--version", action="version", version=f"mfcmt {__version__}")
    names = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    chosen = next((a for a in argv if a in COMMANDS), None)
    module: Command | None = None
    for name, (path, summary) in COMMANDS.items():
        sub = names.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
        if name == chosen:
            try:
                module = cast(Command, importlib.import_module(path))
            except ModuleNotFoundError as missing:
                if missing.name is None or missing.name.startswith(("mfcmt_core.", "service.")):
                    raise
                print(f"mfcmt {name}: needs {missing.name}: pip install 'mfcmt[service]'", file=sys.stderr)
                return 1
            module.configure(sub)
    if "--box" in argv:
        from .boxes import join_box

        argv = join_box(argv)
    args = parser.parse_args(argv)
    assert module is not None
    try:
        return module.run(args)
    except UsageError as bad:
        print(f"mfcmt {args.command}: {bad}", file=sys.stderr)
        return 2
    except MFCMTError as failed:
        print(f"mfcmt {args.command}: {failed}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
