"""What a database of sessions does, and the thread that writes to it, so that the event loop never waits."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import structlog

from ..observability.metrics import Metrics
from ..protocol.enums import EndReason
from .replay_log import Operation

RETRY_S = 1.0
LOG_EVERY_S = 60.0

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.state")


class StateError(Exception):
    """The database cannot be used; the text says why and what to do."""


@dataclass(slots=True)
class SavedSession:
    """A session as it is saved.

    ``front`` is what the front knows of it, as plain values, and ``checkpoint`` the operation that makes its state.
    ``entries`` are those of the trajectory since the session was saved before, by rising number and including the
    newest one of then; entries before ``first_seq`` are gone. ``whole`` is True if nothing has happened since.
    ``epoch`` is that of the claim under which it is saved, and ``keep_s`` the seconds for which it may be needed.
    """

    id: str
    owner: str
    front: dict[str, Any]
    checkpoint: Operation
    entries: deque[tuple[int, bytes]]
    first_seq: int
    whole: bool
    epoch: int = 0
    keep_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Ended:
    """A session that has ended: whose it was, under which claim, and why it ended."""

    owner: str
    epoch: int
    reason: EndReason
    detail: str = ""


class SessionDatabase(Protocol):
    """Where sessions outlive their process. Only :meth:`save` and :meth:`delete` may be called on the event loop.

    Whoever goes on with a session claims it, and gets an epoch above all earlier ones. What is saved under an earlier
    epoch changes nothing, so that a process that was taken for dead cannot undo what its successor did.
    """

    def open(self) -> None:
        """Open the database. Raises StateError."""

    def take_over(self) -> None:
        """Begin to write: what an earlier process of this service left is now this one's. Raises StateError."""

    def load(self) -> tuple[list[SavedSession], list[tuple[str, str]]]:
        """Return, once, the sessions that were taken over, and the ids and owners of damaged ones."""

    def claim(self, sid: str) -> SavedSession | None:
        """Claim a session and return its newest state with the epoch of the claim; None if there is none."""

    def save(self, saved: SavedSession) -> None:
        """Have a session written soon, unless its epoch is late."""

    def delete(self, sid: str, ended: Ended | None = None) -> None:
        """Have a session forgotten; where others may ask for it, they are told how it ``ended``."""

    def flush(self, timeout_s: float, sid: str | None = None) -> bool:
        """Wait until everything, or the session ``sid``, is written; return whether it is."""

    def close(self) -> bool:
        """Write what waits, if that is possible at once, and close; return whether everything is written."""


Change = SavedSession | Ended | None


class BackgroundWriter(ABC):
    """The part of a database that keeps what waits to be written, and the thread that writes it.

    A session is written at most every ``every_s`` seconds, unless it is new, whole or has ended. ``on_late`` is called,
    in the thread, with the ids of sessions that others have claimed.
    """

    faults: ClassVar[tuple[type[Exception], ...]]
    """What :meth:`_write` raises when it failed and may succeed later."""
    tells_ends: ClassVar[bool] = False
    """Whether the end of a session is written even if the session itself never was."""

    def __init__(self, metrics: Metrics, every_s: float = 0.0) -> None:
        self.on_late: Callable[[list[str]], None] = lambda _: None
        self._metrics, self._every_s = metrics, every_s
        # What waits to be written, what is being written, and the sessions that are in the database.
        self._waiting: dict[str, Change] = {}
        self._batch: dict[str, Change] = {}
        self._stored: set[str] = set()
        self._written_at: dict[str, float] = {}
        # True while there is more to do than to write, such as to erase.
        self._remains = False
        self._closing = False
        self._hurried: set[str] = set()
        self._failure_logged_at: float | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="mfcmt-state-writer", daemon=True)

    @abstractmethod
    def _write(self, batch: Mapping[str, Change]) -> list[str]:
        """Write the batch, and return the ids of sessions that others have claimed."""

    @abstractmethod
    def _where(self) -> str:
        """Return where the sessions are, for the log."""

    def _finish(self) -> None:  # noqa: B027
        """Do what ``_remains`` stands for."""

    def _release(self) -> None:  # noqa: B027
        """Close what is open."""

    def save(self, saved: SavedSession) -> None:
        """Have a session written, in place of an earlier state of it that still waits."""
        with self._changed:
            before = self._waiting.get(saved.id)
            if isinstance(before, SavedSession):
                saved.entries = _merged(before.entries, saved)
            self._waiting[saved.id] = saved
            self._changed.notify_all()

    def delete(self, sid: str, ended: Ended | None = None) -> None:
        """Have a session removed, if it is or will be in the database."""
        with self._changed:
            self._written_at.pop(sid, None)
            if self.tells_ends or sid in self._stored or sid in self._batch:
                self._waiting[sid] = ended
                self._changed.notify_all()
            else:
                self._waiting.pop(sid, None)

    def drop(self, sid: str) -> None:
        """Write nothing more of a session that another process goes on with."""
        with self._changed:
            self._waiting.pop(sid, None)
            self._written_at.pop(sid, None)
            self._stored.discard(sid)

    def flush(self, timeout_s: float, sid: str | None = None) -> bool:
        """Wait until everything, or the session ``sid``, is written, and what was removed is erased."""

        def done() -> bool:
            if sid is not None:
                return sid not in self._waiting and sid not in self._batch
            return not (self._waiting or self._batch or self._remains)

        with self._changed:
            self._hurried |= self._waiting.keys() if sid is None else self._waiting.keys() & {sid}
            self._changed.notify_all()
            return self._changed.wait_for(done, timeout_s)

    def close(self) -> bool:
        """Write what waits, if that is possible at once, and close; return whether everything is written."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        if self._thread.ident is not None:
            self._thread.join()
        self._release()
        return not self._waiting

    def _run(self) -> None:
        while self._take_batch():
            started, last = time.monotonic(), self._closing
            try:
                if self._batch:
                    late = self._write(self._batch)
                    self._metrics.state_write_seconds.observe(time.monotonic() - started)
                    self._batch_written(late)
                if self._remains:
                    self._finish()
            except self.faults as failed:
                self._failed(failed)
                if last:
                    return
            else:
                self._succeeded()

    def _take_batch(self) -> bool:
        """Wait until there is something to do, and take it; return False once there is nothing more."""
        with self._changed:
            while not (due := self._due()) and not self._remains and not self._closing:
                self._changed.wait(self._soonest_s())
            self._batch = {sid: self._waiting.pop(sid) for sid in due}
            return bool(self._batch or self._remains)

    def _due(self) -> list[str]:
        """Return the ids of what waits and may be written now."""
        if not self._every_s or self._closing:
            return list(self._waiting)
        soonest = time.monotonic() - self._every_s
        return [sid for sid, change in self._waiting.items() if self._due_at(sid, change) <= soonest]

    def _due_at(self, sid: str, change: Change) -> float:
        if not isinstance(change, SavedSession) or change.whole or sid in self._hurried:
            return 0.0
        return self._written_at.get(sid, 0.0)

    def _soonest_s(self) -> float | None:
        """Return the seconds until something is due; None while nothing waits."""
        if not self._waiting:
            return None
        first = min(self._due_at(sid, change) for sid, change in self._waiting.items())
        return max(0.001, first + self._every_s - time.monotonic())

    def _batch_written(self, late: list[str]) -> None:
        with self._changed:
            for sid, change in self._batch.items():
                self._hurried.discard(sid)
                if isinstance(change, SavedSession):
                    self._stored.add(sid)
                    if self._every_s:
                        self._written_at[sid] = time.monotonic()
                else:
                    self._stored.discard(sid)
                    self._remains = True
            self._batch = {}
            for sid in late:
                self.drop(sid)
        if late:
            self.on_late(late)

    def _succeeded(self) -> None:
        with self._changed:
            self._remains = False
            self._changed.notify_all()
        if self._failure_logged_at is not None:
            self._failure_logged_at = None
            log.info("sessions are written again")

    def _failed(self, failed: Exception) -> None:
        """Keep what was not written for the next attempt, together with what has come meanwhile."""
        self._metrics.state_write_failures.inc()
        with self._changed:
            newer, self._waiting, self._batch = self._waiting, self._batch, {}
            for sid, change in newer.items():
                self.save(change) if isinstance(change, SavedSession) else self.delete(sid, change)
            sessions = len(self._waiting)
        now = time.monotonic()
        if self._failure_logged_at is None or now - self._failure_logged_at >= LOG_EVERY_S:
            self._failure_logged_at = now
            log.error("sessions cannot be written", fault=str(failed), where=self._where(), sessions=sessions)
        with self._changed:
            self._changed.wait_for(lambda: self._closing, RETRY_S)


def _merged(older: deque[tuple[int, bytes]], newer: SavedSession) -> deque[tuple[int, bytes]]:
    """Return the ``older`` entries and those of ``newer``, which replace entries of the same number."""
    while older and older[0][0] < newer.first_seq:
        older.popleft()
    while older and newer.entries and older[-1][0] >= newer.entries[0][0]:
        older.pop()
    older.extend(newer.entries)
    return older
