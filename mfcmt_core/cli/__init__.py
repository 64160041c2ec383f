"""The ``mfcmt`` command: each subcommand is a module that is imported when it runs."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import NoReturn, Protocol, cast

from .. import __version__
from ..errors import MFCMTError

GROUP = "mfcmt.commands"
"""Entry points of this group name tables like :data:`COMMANDS`: the commands of other packages."""


class Command(Protocol):
    """The two functions that a subcommand's module defines."""

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""

    def run(self, args: argparse.Namespace) -> int:
        """Do the work and return the exit code. Raises :class:`UsageError` for invalid arguments."""


class UsageError(Exception):
    """The arguments exclude each other or name something that is missing. Printed as one line, with exit code 2."""


def has_screen() -> bool:
    """Return True if there is a screen for a browser. Without one, webbrowser would start one in this terminal."""
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def add_batch(parser: argparse.ArgumentParser, of: str = "") -> None:
    """Add the arguments of a command that runs jobs by :func:`~mfcmt_core.otb.batch.run_batch`."""
    from ..otb.batch import BACKENDS, LOCAL

    parser.add_argument("--jobs", type=_count, metavar="N", help=f"{of}number of processes (default: one per CPU)")
    where = "where they run: here, or on a Ray or Dask cluster whose machines have mfcmt and the same files"
    parser.add_argument("--backend", choices=BACKENDS, default=LOCAL, help=f"{of}{where} (default: {LOCAL})")


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError("is a number from 1 on")
    return int(text)


@dataclass(frozen=True, slots=True)
class Subcommand:
    """A subcommand: a line for the help, and a function that loads its module when it runs."""

    summary: str
    load: Callable[[], Command]

    @classmethod
    def of(cls, module: str, summary: str) -> Subcommand:
        """Return the entry of a command in ``module``, named in full."""
        return cls(summary, lambda: cast(Command, importlib.import_module(module)))


COMMANDS = {
    "track": Subcommand.of("mfcmt_core.cli.track", "follow a box through images, a video or a camera"),
    "eval": Subcommand.of("mfcmt_core.cli.evaluate", "score trackers on OTB: OPE, TRE, SRE"),
    "bench": Subcommand.of("mfcmt_core.cli.bench", "measure milliseconds per frame and stage, alone or against others"),
    "trax": Subcommand.of("mfcmt_core.cli.trax", "serve the tracker to the VOT toolkit, which starts this command"),
    "warmup": Subcommand.of("mfcmt_core.cli.warmup", "compile the kernels for this CPU and keep them on disk"),
}


def commands() -> dict[str, Subcommand]:
    """Return the library's commands and those that other packages declare, by name."""
    found = dict(COMMANDS)
    for point in entry_points(group=GROUP):
        found |= point.load()
    return found


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Print one line instead of the usage."""
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def main(argv: list[str] | None = None) -> int:
    """Run the ``mfcmt`` command and return its exit code: 0 done, 1 failed, 2 bad arguments, 130 interrupted."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # before numpy is loaded: for its small matrices, threads only cost time
    argv = sys.argv[1:] if argv is None else argv
    parser = _Parser(prog="mfcmt", description="Track a target through video on a CPU.")
    parser.add_argument("--version", action="version", version=f"mfcmt {__version__}")
    names = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    entries = commands()
    chosen = next((a for a in argv if a in entries), None)
    module: Command | None = None
    for name, entry in entries.items():
        summary = entry.summary
        sub = names.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
        if name == chosen:
            try:
                module = entry.load()
            except ModuleNotFoundError as missing:
                if missing.name is None or missing.name.startswith(("mfcmt_core.", "service.")):
                    raise
                print(f"mfcmt {name}: needs {missing.name}; run pip install 'mfcmt[service]'", file=sys.stderr)
                return 1
            except UsageError as absent:
                print(f"mfcmt {name}: {absent}", file=sys.stderr)
                return 2
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
