"""Log lines that any client can cause, limited to a number per second of each kind."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import structlog

LINES_A_SECOND = 20


@dataclass(slots=True)
class _Kind:
    """Counts the lines of one event and code in the second that began at ``since``."""

    since: float
    written: int = 0
    left_out: int = 0


class Sampled:
    """Logs refusals. When lines were left out, the next one says how many as ``left_out``."""

    def __init__(self, log: structlog.stdlib.BoundLogger, clock: Callable[[], float] = time.monotonic) -> None:
        self._log, self._clock = log, clock
        self._kinds: dict[tuple[str, str], _Kind] = {}

    def info(self, event: str, *, code: str, **fields: Any) -> None:
        """Write a line, unless there were too many of this event and ``code`` in this second."""
        now = self._clock()
        kind = self._kinds.get((event, code))
        if kind is None:
            kind = self._kinds[event, code] = _Kind(now)
        elif now - kind.since >= 1.0:
            kind.since, kind.written = now, 0
        if kind.written >= LINES_A_SECOND:
            kind.left_out += 1
            return
        kind.written += 1
        if kind.left_out:
            fields["left_out"], kind.left_out = kind.left_out, 0
        self._log.info(event, code=code, **fields)
