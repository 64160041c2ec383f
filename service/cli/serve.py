"""``mfcmt serve``: run the tracking service."""

from __future__ import annotations

import argparse
import sys
from typing import Any

import structlog
from pydantic import ValidationError
from pydantic.fields import FieldInfo

from mfcmt_core.cli import UsageError

from ..settings import Settings, unread_settings
from .address import check_free

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.serve")

# The exit code if sessions could not be written to the state directory.
NOT_WRITTEN = 3
FLAGS = ("host", "port", "lanes", "log_format", "log_level")
SAMPLE = "static/page/sample.jpg"
SAMPLE_BOX = "278,184,84,112"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments; the help lists every setting."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    for name in FLAGS:
        field = Settings.model_fields[name]
        parser.add_argument(f"--{name.replace('_', '-')}", dest=name, help=field.description, metavar="VALUE")
    parser.add_argument(
        "--nodes",
        type=int,
        metavar="N",
        help="run N nodes on ports from --port on, which share the store MFCMT_STORE (docs/scaling.md)",
    )
    lines = [f"  {_variable(name)}{_default(field)}\n      {field.description}" for name, field in _fields()]
    parser.epilog = "Settings, from the environment; an argument above goes before its variable.\n\n" + "\n".join(lines)


def run(args: argparse.Namespace) -> int:
    """Serve until a signal; the first drains, the second stops at once."""
    given = {name: value for name in FLAGS if (value := getattr(args, name)) is not None}
    if args.nodes is not None:
        given |= {"store": None, "node": "", "node_url": ""}  # each node reads them for itself
    try:
        settings = Settings(**given)
    except ValidationError as wrong:
        raise UsageError("; ".join(_message(error) for error in wrong.errors(include_input=False))) from None

    if args.nodes is not None:
        from . import serve_nodes

        return serve_nodes.run(args.nodes, settings)
    check_free(settings.host, settings.port)

    from ..app import create_app
    from ..observability import logs
    from ..server import make_server
    from ..sessions.database import StateError

    logs.configure(settings.log_format, settings.log_level)
    for line in unread_settings():
        log.warning(line)
    try:
        app = create_app(settings)
        app.state.service.registry.store.open()
    except StateError as bad:
        print(f"mfcmt serve: {bad}", file=sys.stderr)
        return 1

    def tell(url: str) -> None:
        if logs.is_console(settings.log_format):
            print(first_steps(url, settings.authenticated), file=sys.stderr, flush=True)

    server = make_server(app, tell)
    try:
        server.run()
    except SystemExit as failed:
        # uvicorn has logged why: an address in use, a part that did not start.
        print("mfcmt serve: could not start", file=sys.stderr)
        return int(failed.code or 1)
    if not app.state.service.registry.store.all_written:
        lost = "some sessions could not be written at the stop; the next start has an older state of them"
        todo = f"Make room in {settings.state_dir}" if settings.state_dir else "See why Redis did not answer"
        print(f"mfcmt serve: {lost}. {todo}", file=sys.stderr)
        return NOT_WRITTEN
    return 0


def first_steps(url: str, authenticated: bool = False) -> str:
    """The page's address and a command that makes a first session, to paste into a terminal."""
    key = '-H "X-API-Key: $KEY" ' if authenticated else ""
    return (
        f"\nready: the page is at {url}, a first session is made by\n\n"
        f"  curl -sS {url}/{SAMPLE} | curl -sS {key}-F frame=@- -F box={SAMPLE_BOX} {url}/v1/sessions\n"
    )


def _fields() -> list[tuple[str, FieldInfo]]:
    return list(Settings.model_fields.items())


def _variable(name: str) -> str:
    return f"MFCMT_{name.upper()}"


def _default(field: FieldInfo) -> str:
    value: Any = field.get_default(call_default_factory=True)
    return "" if value in (None, "", ()) else f"={value}"


def _message(error: Any) -> str:
    name = _variable(str(error["loc"][0])) if error["loc"] else "settings"
    return f"{name}: {error['msg'].removeprefix('Value error, ')}"
