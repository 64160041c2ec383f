"""End a command well at Ctrl-C, SIGTERM and SIGHUP: what is being written is completed first."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Self

ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


class Ended(KeyboardInterrupt):
    """A signal asks to end. ``code`` is the exit code for it, 128 and the signal's number."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.code = 128 + number


class Ending:
    """Raises :class:`Ended` at a signal, in ``with Ending() as ending:``; within ``ending.held()`` at the end of it."""

    def __init__(self) -> None:
        self._held = False
        self._number: int | None = None
        self._before: dict[int, object] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._hear) for number in ENDING}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    def _hear(self, number: int, _: FrameType | None) -> None:
        if self._held:
            self._number = number
        else:
            raise Ended(number)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Let no signal interrupt the block."""
        self._held = True
        try:
            yield
        finally:
            self._held = False
        number, self._number = self._number, None
        if number is not None:
            raise Ended(number)
