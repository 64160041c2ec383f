"""Logging by structlog: JSON in a container, plain text on a terminal, for uvicorn's lines too."""

from __future__ import annotations

import logging
import sys
from collections.abc import MutableMapping
from typing import Any, Literal

import structlog

UVICORNS_OWN = ("Invalid HTTP request received.", "Unsupported upgrade request.")
SECRET_NAMES = frozenset({"authorization", "x-api-key", "key", "ticket", "cookie"})


def is_console(form: Literal["auto", "json", "console"]) -> bool:
    """Return whether the log is plain text for people."""
    return form == "console" or (form == "auto" and sys.stderr.isatty())


def configure(form: Literal["auto", "json", "console"], level: str) -> None:
    """Set up logging for this process, to standard error."""
    shared: list[Any] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        _without_secrets,
    ]
    last: list[Any] = (
        [structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty())]
        if is_console(form)
        else [structlog.processors.format_exc_info, structlog.processors.JSONRenderer()]
    )
    structlog.configure(
        processors=[
            structlog.stdlib.filter_by_level,
            *shared,
            structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
        ],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=True,
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *last],
        )
    )
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level.upper())
    # At INFO uvicorn repeats our lines, with paths and their queries.
    for name in ("uvicorn", "uvicorn.error", "uvicorn.access", "asyncio", "websockets"):
        logging.getLogger(name).setLevel(logging.WARNING)
    logging.getLogger("uvicorn.error").addFilter(_is_no_repetition)


def _is_no_repetition(record: logging.LogRecord) -> bool:
    """Return False for lines that any client can cause at will: the service logs and counts the refusal itself."""
    return record.msg not in UVICORNS_OWN


def _without_secrets(
    logger: Any,  # noqa: ARG001
    method: str,  # noqa: ARG001
    event: MutableMapping[str, Any],
) -> MutableMapping[str, Any]:
    for name in SECRET_NAMES & event.keys():
        event[name] = "***"
    return event
