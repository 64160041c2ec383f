"""End a command well at Ctrl-C, SIGTERM and SIGHUP: what is being written is completed first."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
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
        self._then: Callable[[], object] | None = None
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
        if not self._held or (self._then and self._number):
            raise Ended(number)
        self._number = number
        if self._then:
            self._then()

    @contextmanager
    def held(self, then: Callable[[], object] | None = None) -> Iterator[None]:
        """Let no signal interrupt the block; with ``then`` only the first, which calls it to have the block end."""
        self._held, self._then = True, then
        try:
            yield
        finally:
            self._held, self._then = False, None
        number, self._number = self._number, None
        if number is not None:
            raise Ended(number)
