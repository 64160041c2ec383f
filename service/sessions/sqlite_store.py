"""Sessions on disk: an SQLite file that one thread writes and one process at a time may open."""

from __future__ import annotations

import errno
import os
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import msgpack
import structlog

from ..observability.metrics import Metrics
from .replay_log import Operation

FILE = "sessions.sqlite3"
VERSION = 1
# Marks a file in which nothing that was deleted can be read: earlier versions left remains in free pages.
ERASED = 0x4D464354
LOCK_TIMEOUT_S = 5.0
RETRY_S = 1.0
TELL_EVERY_S = 60.0
MOST_AT_ONCE = 1 << 28
# What is deleted is overwritten, large values too: FAST would leave them in free pages. No other file has any of it.
PRAGMAS = (
    "locking_mode=EXCLUSIVE",
    "journal_mode=WAL",
    "synchronous=NORMAL",
    "secure_delete=ON",
    "temp_store=MEMORY",
)
SCHEMA = """
CREATE TABLE session (id TEXT PRIMARY KEY, owner TEXT NOT NULL, front BLOB NOT NULL, op TEXT NOT NULL,
    args BLOB NOT NULL, data BLOB NOT NULL, checksum INTEGER NOT NULL, whole INTEGER NOT NULL);
CREATE TABLE trajectory (session TEXT NOT NULL, seq INTEGER NOT NULL, entry BLOB NOT NULL,
    PRIMARY KEY (session, seq)) WITHOUT ROWID;
"""

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.state")


class StateDirError(Exception):
    """The state directory cannot be used; the text says why and what to do."""


@dataclass(slots=True)
class SavedSession:
    """A session as it is kept: what the front knows of it, plain; the operation that makes its state.

    ``entries`` are those of the trajectory since it was saved before, by rising number, the newest one then among
    them; those before ``first_seq`` are gone. ``whole``: nothing has happened since.
    """

    id: str
    owner: str
    front: dict[str, Any]
    base: Operation
    entries: deque[tuple[int, bytes]]
    first_seq: int
    whole: bool


class SqliteStore:
    """Only :meth:`open`, :meth:`take_over`, :meth:`flush` and :meth:`close` wait for the disk."""

    def __init__(self, folder: Path, metrics: Metrics) -> None:
        self._folder, self._metrics = folder, metrics
        # What is to be written, what is being written, and the sessions that the file has; None: to be removed.
        self._waiting: dict[str, SavedSession | None] = {}
        self._batch: dict[str, SavedSession | None] = {}
        self._stored: set[str] = set()
        self._remains = self._closing = False
        self._told_at: float | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="mfcmt-state-writer", daemon=True)
        self._db: sqlite3.Connection | None = None
        self._found: list[SavedSession] = []
        self._damaged: list[tuple[str, str]] = []

    def open(self) -> None:
        """Open and read; again, nothing more. Raises StateDirError."""
        if self._db is not None:
            return
        try:
            self._db = self._connect()
            self._read(self._db)
        except (OSError, sqlite3.Error) as broken:
            raise self._bad(broken) from broken

    def take_over(self) -> None:
        """Take the sessions over: from now on only :meth:`save` says that one is whole. Raises StateDirError."""
        self.open()
        db = self._db
        assert db is not None
        try:
            with _transaction(db):
                db.execute("UPDATE session SET whole = 0")
                for sid, _ in self._damaged:
                    _remove(db, sid)
            _empty_log(db)
            self._stored.difference_update(sid for sid, _ in self._damaged)
        except sqlite3.Error as broken:
            raise self._bad(broken) from broken
        self._thread.start()

    def load(self) -> tuple[list[SavedSession], list[tuple[str, str]]]:
        """The sessions that were found, in the order of their making, and ids and owners of damaged ones; once."""
        found, self._found = self._found, []
        damaged, self._damaged = self._damaged, []
        return found, damaged

    def save(self, saved: SavedSession) -> None:
        """Have a session written; of one that still waits only the newest state is."""
        with self._changed:
            before = self._waiting.get(saved.id)
            if before is not None:
                saved.entries = _joined(before.entries, saved)
            self._waiting[saved.id] = saved
            self._changed.notify_all()

    def delete(self, sid: str) -> None:
        """Have a session removed, if the file has it or is about to."""
        with self._changed:
            if sid in self._stored or sid in self._batch:
                self._waiting[sid] = None
                self._changed.notify_all()
            else:
                self._waiting.pop(sid, None)

    def flush(self, timeout_s: float) -> bool:
        """Wait until everything is written, and everything removed is erased; whether it is."""
        with self._changed:
            return self._changed.wait_for(lambda: not (self._waiting or self._batch or self._remains), timeout_s)

    def close(self) -> bool:
        """Write what waits, if that can be done at once, and close; whether everything is written."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        if self._thread.ident is not None:
            self._thread.join()
        if self._db is not None:
            self._db.close()
        return not self._waiting

    def _connect(self) -> sqlite3.Connection:
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if self._folder.stat().st_mode & 0o007:
            log.warning("the state directory is open to every user", folder=str(self._folder))
        path = self._folder / FILE
        # SQLite gives its other files the mode of this one.
        os.close(os.open(path, os.O_CREAT | os.O_RDWR, 0o600))
        path.chmod(0o600)
        db = sqlite3.connect(path, timeout=LOCK_TIMEOUT_S, isolation_level=None, check_same_thread=False)
        for pragma in PRAGMAS:
            db.execute(f"PRAGMA {pragma}")
        db.execute("BEGIN EXCLUSIVE")
        version = db.execute("PRAGMA user_version").fetchone()[0]
        if version not in (0, VERSION):
            raise sqlite3.DatabaseError(f"version {version} is not read here")
        if version == 0:
            for statement in SCHEMA.split(";"):
                db.execute(statement)
        # Written in any case: whether there is room shows here, and not under the first stream.
        db.execute(f"PRAGMA user_version={VERSION}")
        db.execute("COMMIT")
        _erase_remains(db)
        _empty_log(db)
        return db

    def _read(self, db: sqlite3.Connection) -> None:
        for sid, owner, front, op, args, data, checksum, whole in db.execute("SELECT * FROM session ORDER BY rowid"):
            self._stored.add(sid)
            if _checksum(front, args, data) != checksum:
                log.error("saved session is damaged", session=sid)
                self._damaged.append((sid, owner))
                continue
            known = msgpack.unpackb(front)
            entries = db.execute(
                "SELECT seq, entry FROM trajectory WHERE session = ? AND seq <= ? ORDER BY seq", (sid, known["seq"])
            )
            base = Operation(op, msgpack.unpackb(args), data)
            self._found.append(SavedSession(sid, owner, known, base, deque(entries), 0, bool(whole)))

    def _bad(self, broken: Exception) -> StateDirError:
        return StateDirError(f"the state in {self._folder} cannot be used ({broken}): {_hint(broken)}")

    def _run(self) -> None:
        assert self._db is not None
        while self._next():
            started, last = time.monotonic(), self._closing
            try:
                if self._batch:
                    _write(self._db, self._batch)
                    self._metrics.state_write_seconds.observe(time.monotonic() - started)
                    self._written()
                if self._remains:
                    _empty_log(self._db)
            except sqlite3.Error as failed:
                self._failed(failed)
                if last:
                    return
            else:
                self._succeeded()

    def _next(self) -> bool:
        """Wait until there is something to do, and take it; False when that is all."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._remains or self._closing)
            self._batch, self._waiting = self._waiting, {}
            return bool(self._batch or self._remains)

    def _written(self) -> None:
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
        if self._told_at is not None:
            self._told_at = None
            log.info("sessions are written again")

    def _failed(self, failed: sqlite3.Error) -> None:
        """Keep what was not written for the next try, with what has come meanwhile."""
        self._metrics.state_write_failures.inc()
        with self._changed:
            newer, self._waiting, self._batch = self._waiting, self._batch, {}
            for sid, saved in newer.items():
                self.save(saved) if saved is not None else self.delete(sid)
            sessions = len(self._waiting)
        now = time.monotonic()
        if self._told_at is None or now - self._told_at >= TELL_EVERY_S:
            self._told_at = now
            log.error("sessions cannot be written", fault=str(failed), folder=str(self._folder), sessions=sessions)
        with self._changed:
            self._changed.wait_for(lambda: self._closing, RETRY_S)


def _hint(broken: Exception) -> str:
    if "locked" in str(broken):
        return "another process uses it"
    if "full" in str(broken) or getattr(broken, "errno", None) == errno.ENOSPC:
        return "make room on its disk"
    if isinstance(broken, OSError) or "readonly" in str(broken) or "unable to open" in str(broken):
        return "this user must be able to write there"
    return "move it away to start without"


def _empty_log(db: sqlite3.Connection) -> None:
    """Move all from the write-ahead log into the file and cut the log off, with the deleted pages that it holds."""
    busy, *_ = db.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    if busy:
        raise sqlite3.OperationalError("the write-ahead log cannot be emptied")


def _erase_remains(db: sqlite3.Connection) -> None:
    """Overwrite what an earlier version has left of ended sessions in free pages; once in a file's life."""
    if db.execute("PRAGMA application_id").fetchone()[0] == ERASED:
        return
    free = db.execute("PRAGMA freelist_count").fetchone()[0] * db.execute("PRAGMA page_size").fetchone()[0]
    try:
        with _transaction(db):
            # Takes up all free pages and gives them back, which overwrites them.
            db.execute("CREATE TABLE remains (bytes BLOB)")
            for begin in range(0, free, MOST_AT_ONCE):
                db.execute("INSERT INTO remains VALUES (zeroblob(?))", (min(MOST_AT_ONCE, free - begin),))
            db.execute("DROP TABLE remains")
            db.execute(f"PRAGMA application_id={ERASED}")
    except sqlite3.Error as failed:
        log.warning("remains of ended sessions are not erased; the next start tries again", fault=str(failed))


@contextmanager
def _transaction(db: sqlite3.Connection) -> Iterator[None]:
    db.execute("BEGIN")
    try:
        yield
        db.execute("COMMIT")
    except BaseException:
        if db.in_transaction:
            db.execute("ROLLBACK")
        raise


def _joined(older: deque[tuple[int, bytes]], newer: SavedSession) -> deque[tuple[int, bytes]]:
    """``older`` entries and those of ``newer``, which replace entries of the same number."""
    while older and older[0][0] < newer.first_seq:
        older.popleft()
    while older and newer.entries and older[-1][0] >= newer.entries[0][0]:
        older.pop()
    older.extend(newer.entries)
    return older


def _write(db: sqlite3.Connection, batch: dict[str, SavedSession | None]) -> None:
    with _transaction(db):
        for sid, saved in batch.items():
            if saved is None:
                _remove(db, sid)
            else:
                _put(db, saved)


def _put(db: sqlite3.Connection, saved: SavedSession) -> None:
    front, args, data = msgpack.packb(saved.front), msgpack.packb(saved.base.args), saved.base.data
    db.execute(
        "INSERT INTO session VALUES (?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (id) DO UPDATE SET front = excluded.front, "
        "op = excluded.op, args = excluded.args, data = excluded.data, checksum = excluded.checksum, "
        "whole = excluded.whole",
        (saved.id, saved.owner, front, saved.base.op, args, data, _checksum(front, args, data), saved.whole),
    )
    rows = [(saved.id, seq, entry) for seq, entry in saved.entries]
    db.executemany("INSERT OR REPLACE INTO trajectory VALUES (?, ?, ?)", rows)
    db.execute("DELETE FROM trajectory WHERE session = ? AND seq < ?", (saved.id, saved.first_seq))


def _remove(db: sqlite3.Connection, sid: str) -> None:
    db.execute("DELETE FROM session WHERE id = ?", (sid,))
    db.execute("DELETE FROM trajectory WHERE session = ?", (sid,))


def _checksum(*parts: bytes | memoryview) -> int:
    total = 0
    for part in parts:
        total = crc32(part, total)
    return total
