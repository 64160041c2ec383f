"""Sessions on disk, written by one thread."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections import deque
from pathlib import Path

import structlog

from ..observability.metrics import Metrics
from .state_file import SavedSession, StateFile

RETRY_S = 1.0
LOG_EVERY_S = 60.0

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.state")


class SqliteStore:
    """Saves and deletes sessions. Only :meth:`open`, :meth:`take_over`, :meth:`flush` and :meth:`close` wait for it."""

    def __init__(self, folder: Path, metrics: Metrics) -> None:
        self._file, self._metrics = StateFile(folder), metrics
        # The sessions that wait to be written, those that are being written (None: to be deleted), and those on disk.
        self._waiting: dict[str, SavedSession | None] = {}
        self._batch: dict[str, SavedSession | None] = {}
        self._stored: set[str] = set()
        # True while deleted data may be in the write-ahead log.
        self._remains = False
        self._closing = False
        self._failure_logged_at: float | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="mfcmt-state-writer", daemon=True)
        self._found: list[SavedSession] = []
        self._damaged: list[tuple[str, str]] = []

    def open(self) -> None:
        """Open the file and read its sessions, unless it is open. Raises StateDirError."""
        if self._file.db is not None:
            return
        self._file.open()
        try:
            self._found, self._damaged = self._file.read()
        except sqlite3.Error as broken:
            self._file.close()
            raise self._file.unusable(broken) from broken
        self._stored = {saved.id for saved in self._found}

    def take_over(self) -> None:
        """Take over the sessions: from now on, one is whole only if :meth:`save` says so. Raises StateDirError."""
        self.open()
        try:
            self._file.take_over(self._damaged)
        except sqlite3.Error as broken:
            raise self._file.unusable(broken) from broken
        self._thread.start()

    def load(self) -> tuple[list[SavedSession], list[tuple[str, str]]]:
        """Return, once, the sessions in the order of their making, and the ids and owners of damaged ones."""
        found, self._found = self._found, []
        damaged, self._damaged = self._damaged, []
        return found, damaged

    def save(self, saved: SavedSession) -> None:
        """Have a session written, in place of an earlier state of it that still waits."""
        with self._changed:
            before = self._waiting.get(saved.id)
            if before is not None:
                saved.entries = _merged(before.entries, saved)
            self._waiting[saved.id] = saved
            self._changed.notify_all()

    def delete(self, sid: str) -> None:
        """Have a session removed from the file, if it is or will be there."""
        with self._changed:
            if sid in self._stored or sid in self._batch:
                self._waiting[sid] = None
                self._changed.notify_all()
            else:
                self._waiting.pop(sid, None)

    def flush(self, timeout_s: float) -> bool:
        """Wait until everything is written, and what was removed is erased; return whether it is."""
        with self._changed:
            return self._changed.wait_for(lambda: not (self._waiting or self._batch or self._remains), timeout_s)

    def close(self) -> bool:
        """Write what waits, if that is possible at once, and close; return whether everything is written."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        if self._thread.ident is not None:
            self._thread.join()
        self._file.close()
        return not self._waiting

    def _run(self) -> None:
        while self._take_batch():
            started, last = time.monotonic(), self._closing
            try:
                if self._batch:
                    self._file.write(self._batch)
                    self._metrics.state_write_seconds.observe(time.monotonic() - started)
                    self._batch_written()
                if self._remains:
                    self._file.empty_log()
            except sqlite3.Error as failed:
                self._failed(failed)
                if last:
                    return
            else:
                self._succeeded()

    def _take_batch(self) -> bool:
        """Wait until there is something to do, and take it; return False once there is nothing more."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._remains or self._closing)
            self._batch, self._waiting = self._waiting, {}
            return bool(self._batch or self._remains)

    def _batch_written(self) -> None:
        with self._changed:
            for sid, saved in self._batch.items():
                if saved is None:
                    self._stored.discard(sid)
                    self._remains = True
                else:
                    self._stored.add(sid)
            self._batch = {}

    def _succeeded(self) -> None:
        with self._changed:
            self._remains = False
            self._changed.notify_all()
        if self._failure_logged_at is not None:
            self._failure_logged_at = None
            log.info("sessions are written again")

    def _failed(self, failed: sqlite3.Error) -> None:
        """Keep what was not written for the next attempt, together with what has come meanwhile."""
        self._metrics.state_write_failures.inc()
        with self._changed:
            newer, self._waiting, self._batch = self._waiting, self._batch, {}
            for sid, saved in newer.items():
                self.save(saved) if saved is not None else self.delete(sid)
            sessions = len(self._waiting)
        now = time.monotonic()
        if self._failure_logged_at is None or now - self._failure_logged_at >= LOG_EVERY_S:
            self._failure_logged_at = now
            folder = str(self._file.folder)
            log.error("sessions cannot be written", fault=str(failed), folder=folder, sessions=sessions)
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
