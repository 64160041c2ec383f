"""The SQLite file of the state directory, which one process at a time may open."""

from __future__ import annotations

import errno
import os
import sqlite3
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from zlib import crc32

import msgpack
import structlog

from .database import SavedSession, StateError
from .replay_log import Operation

FILE = "sessions.sqlite3"
# Version 2 has the options by name, and rows that may be longer than those of version 1 (see service.protocol.target).
# Version 1 is read, too; the file becomes version 2 when its sessions are taken over.
VERSION, READABLE = 2, (1, 2)
# Marks a file in whose free pages nothing can be read: earlier versions left deleted data there.
ERASED = 0x4D464354
LOCK_TIMEOUT_S = 5.0
MAX_BLOB_BYTES = 1 << 28
# Deleted data are overwritten, also large values (FAST would leave them in free pages). No other file holds any.
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


class StateDirError(StateError):
    """The state directory cannot be used; the text says why and what to do."""


class StateFile:
    """Reads and writes sessions. Every method but :meth:`open` and :meth:`close` may raise sqlite3.Error."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.db: sqlite3.Connection | None = None

    def open(self) -> None:
        """Open the file, or make it. Raises StateDirError."""
        try:
            self._connect()
        except (OSError, sqlite3.Error) as broken:
            self.close()
            raise self.unusable(broken) from broken

    def read(self) -> tuple[list[SavedSession], list[tuple[str, str]]]:
        """Return the sessions in the order of their making, and the ids and owners of damaged ones."""
        found, damaged = [], []
        db = self._connection()
        for sid, owner, front, op, args, data, checksum, whole in db.execute("SELECT * FROM session ORDER BY rowid"):
            if _checksum(front, args, data) != checksum:
                log.error("saved session is damaged", session=sid)
                damaged.append((sid, owner))
                continue
            known = msgpack.unpackb(front)
            entries = db.execute(
                "SELECT seq, entry FROM trajectory WHERE session = ? AND seq <= ? ORDER BY seq", (sid, known["seq"])
            )
            checkpoint = Operation(op, msgpack.unpackb(args), data)
            found.append(SavedSession(sid, owner, known, checkpoint, deque(entries), 0, bool(whole)))
        return found, damaged

    def take_over(self, damaged: list[tuple[str, str]]) -> None:
        """Mark all sessions as not whole, and remove the ``damaged`` ones."""
        db = self._connection()
        with _transaction(db):
            db.execute("UPDATE session SET whole = 0")
            for sid, _ in damaged:
                _remove(db, sid)
            db.execute(f"PRAGMA user_version={VERSION}")
        self.empty_log()

    def write(self, batch: Mapping[str, SavedSession | None]) -> None:
        """Save each session of the batch, or remove those that are None, all or none of them."""
        db = self._connection()
        with _transaction(db):
            for sid, saved in batch.items():
                if saved is None:
                    _remove(db, sid)
                else:
                    _put(db, saved)

    def empty_log(self) -> None:
        """Move the write-ahead log into the file and cut it off, with the deleted pages that it holds."""
        busy, *_ = self._connection().execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        if busy:
            raise sqlite3.OperationalError("the write-ahead log cannot be emptied")

    def close(self) -> None:
        """Close the file, if it is open."""
        if self.db is not None:
            self.db.close()
            self.db = None

    def unusable(self, broken: Exception) -> StateDirError:
        """Return the error that says why the directory cannot be used, and what to do."""
        return StateDirError(f"the state in {self.folder} cannot be used ({broken}): {_hint(broken)}")

    def _connection(self) -> sqlite3.Connection:
        assert self.db is not None
        return self.db

    def _connect(self) -> None:
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if self.folder.stat().st_mode & 0o007:
            log.warning("the state directory is open to every user", folder=str(self.folder))
        path = self.folder / FILE
        # SQLite gives its other files the mode of this one.
        os.close(os.open(path, os.O_CREAT | os.O_RDWR, 0o600))
        path.chmod(0o600)
        self.db = db = sqlite3.connect(path, timeout=LOCK_TIMEOUT_S, isolation_level=None, check_same_thread=False)
        for pragma in PRAGMAS:
            db.execute(f"PRAGMA {pragma}")
        db.execute("BEGIN EXCLUSIVE")
        version = db.execute("PRAGMA user_version").fetchone()[0]
        if version not in (0, *READABLE):
            raise sqlite3.DatabaseError(f"version {version} is not read here")
        if version == 0:
            for statement in SCHEMA.split(";"):
                db.execute(statement)
        # Written in any case, so that a full disk shows here and not under the first stream.
        db.execute(f"PRAGMA user_version={version or VERSION}")
        db.execute("COMMIT")
        _erase_remains(db)
        self.empty_log()


def _hint(broken: Exception) -> str:
    if "locked" in str(broken):
        return "another process uses it"
    if "full" in str(broken) or getattr(broken, "errno", None) == errno.ENOSPC:
        return "make room on its disk"
    if isinstance(broken, OSError) or "readonly" in str(broken) or "unable to open" in str(broken):
        return "this user must be able to write there"
    return "move it away to start without"


def _erase_remains(db: sqlite3.Connection) -> None:
    """Overwrite what an earlier version left of ended sessions in free pages; once for each file."""
    if db.execute("PRAGMA application_id").fetchone()[0] == ERASED:
        return
    free = db.execute("PRAGMA freelist_count").fetchone()[0] * db.execute("PRAGMA page_size").fetchone()[0]
    try:
        with _transaction(db):
            # The table takes all free pages and gives them back, which overwrites them.
            db.execute("CREATE TABLE remains (bytes BLOB)")
            for begin in range(0, free, MAX_BLOB_BYTES):
                db.execute("INSERT INTO remains VALUES (zeroblob(?))", (min(MAX_BLOB_BYTES, free - begin),))
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


def _put(db: sqlite3.Connection, saved: SavedSession) -> None:
    checkpoint = saved.checkpoint
    front, args, data = msgpack.packb(saved.front), msgpack.packb(checkpoint.args), checkpoint.data
    db.execute(
        "INSERT INTO session VALUES (?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (id) DO UPDATE SET front = excluded.front, "
        "op = excluded.op, args = excluded.args, data = excluded.data, checksum = excluded.checksum, "
        "whole = excluded.whole",
        (saved.id, saved.owner, front, checkpoint.op, args, data, _checksum(front, args, data), saved.whole),
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
