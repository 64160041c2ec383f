"""A line that tells how far the work is, on a terminal and nowhere else."""

from __future__ import annotations

import shutil
import sys
import time
from types import TracebackType
from typing import Self


class Progress:
    """``with Progress(total) as bar: bar.step("note")``; silent where the standard error is no terminal."""

    def __init__(self, total: int | None) -> None:
        self._total, self._done, self._note = total, 0, ""
        self._start = self._drawn = time.monotonic()
        self._shown = sys.stderr.isatty()

    def __enter__(self) -> Self:
        return self

    def step(self, note: str = "", count: int = 1) -> None:
        """``count`` more are done; redraws at most ten times a second."""
        self._done += count
        self._note = note
        if self._shown and time.monotonic() - self._drawn > 0.1:
            self._draw()

    def _draw(self) -> None:
        self._drawn = time.monotonic()
        rate = self._done / max(self._drawn - self._start, 1e-9)
        text = f"{self._done}/{self._total}" if self._total else f"{self._done}"
        text = f"{text} frames  {rate:.0f}/s  {self._note}"
        if self._total:
            room = max(10, min(40, shutil.get_terminal_size().columns - len(text) - 4))
            full = min(room, room * self._done // self._total)
            text = "━" * full + "╌" * (room - full) + "  " + text
        sys.stderr.write("\r\x1b[2K" + text)
        sys.stderr.flush()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._shown and self._done:
            self._draw()
            sys.stderr.write("\n")
