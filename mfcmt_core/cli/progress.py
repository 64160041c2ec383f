"""A progress line with the time left. It is drawn on a terminal only."""

from __future__ import annotations

import shutil
import sys
import threading
import time
from types import TracebackType
from typing import Self

EVERY_S = 0.25
"""Seconds between two drawings. Another thread draws, so that the work itself only counts."""


class Progress:
    """A progress line: ``with Progress(total) as bar:``, then ``bar.step("note")`` after each unit of work.

    Call ``bar.begin("note")`` instead if a unit is reported when it starts.

    Parameters
    ----------
    total : float or None
        Number of units. None if it is unknown; the attribute may be set later.
    unit : str, optional
        Name of the units, in the plural.
    timed : bool, optional
        The total is in seconds, and the clock counts them.
    shown : bool, optional
        Draw the line. It is never drawn if the standard error is no terminal.
    """

    def __init__(self, total: float | None, unit: str = "frames", *, timed: bool = False, shown: bool = True) -> None:
        self.total, self._unit, self._timed = total, unit, timed
        self._done, self._note, self._begun = 0, "", 0
        self._start = self._stepped = time.monotonic()
        self._shown = shown and sys.stderr.isatty()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._draw_often, daemon=True)

    def __enter__(self) -> Self:
        if self._shown:
            self._thread.start()
        return self

    def step(self, note: str = "", count: int = 1) -> None:
        """Report that ``count`` more units are done."""
        self._done += count
        self._note, self._stepped = note, time.monotonic()

    def begin(self, note: str, count: int = 1) -> None:
        """Report that the last unit is done and that one begins that counts as ``count``."""
        self.step(note, self._begun)
        self._begun = count

    def _draw_often(self) -> None:
        while not self._over.wait(EVERY_S):
            self._draw(time.monotonic())

    def _draw(self, now: float, *, over: bool = False) -> None:
        passed, total = now - self._start, self.total
        done = min(passed, total or passed) if self._timed else self._done
        parts = [f"{done:.0f}/{total:.0f} {self._unit}" if total else f"{done:.0f} {self._unit}"]
        if over:
            parts.append(f"in {_clock(passed)}")
        elif total and done:
            # extrapolated from the last step, and counted down until the next
            took, since = (passed, 0.0) if self._timed else (self._stepped - self._start, now - self._stepped)
            parts.append(f"{_clock(max(0.0, took / done * (total - done) - since))} left")
        if not self._timed:
            parts.append(f"{done / max(passed, 1e-9):.3g}/s")
        text, columns = "  ".join([*parts, self._note]), shutil.get_terminal_size().columns
        if total:
            room = max(10, min(40, columns - len(text) - 4))
            full = min(room, int(room * done / total))
            text = "━" * full + "╌" * (room - full) + "  " + text
        sys.stderr.write("\r\x1b[2K" + text[: columns - 1])
        sys.stderr.flush()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._shown:
            return
        self._over.set()
        self._thread.join()
        if kind is None:
            self._done += self._begun
        self._draw(time.monotonic(), over=True)
        sys.stderr.write("\n")


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
