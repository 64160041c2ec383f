"""Controls of a stream that wait for their answers."""

from __future__ import annotations

import asyncio

from .errors import ClientError, Problem
from .types import Targets


class PendingControls:
    """Gives each control a ``ref`` and hands on the answer that echoes it."""

    def __init__(self) -> None:
        self._waiting: dict[int, asyncio.Future[Targets]] = {}
        self._last_ref = 0

    def add(self) -> tuple[int, asyncio.Future[Targets]]:
        """Return the ``ref`` of a new control, and what will be its answer."""
        self._last_ref += 1
        answer = self._waiting[self._last_ref] = asyncio.get_running_loop().create_future()
        return self._last_ref, answer

    def answer(self, targets: Targets) -> None:
        """Hand on an answer; one without a ``ref`` of ours answers nobody."""
        if (waiting := self._take(targets.ref)) is not None:
            waiting.set_result(targets)

    def refuse(self, problem: Problem) -> bool:
        """Hand on a refusal; False if it is not a control's."""
        if (waiting := self._take(problem.ref)) is None:
            return False
        waiting.set_exception(problem)
        return True

    def fail(self, why: ClientError) -> None:
        """Fail all that wait: the connection that would bring their answers is gone."""
        for waiting in self._waiting.values():
            if not waiting.done():
                waiting.set_exception(why)
        self._waiting.clear()

    def _take(self, ref: object) -> asyncio.Future[Targets] | None:
        return self._waiting.pop(ref, None) if isinstance(ref, int) else None
