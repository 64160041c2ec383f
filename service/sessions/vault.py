"""Sessions on disk: an SQLite file that one thread writes and one process at a time may open."""

from __future__ import annotations

import os
import sqlite3
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import msgpack
import structlog

from ..observability.metrics import Metrics
from .journal import Operation

FILE = "sessions.sqlite3"
VERSION = 1
LOCK_TIMEOUT_S = 5.0
RETRY_S = 1.0
SCHEMA = """
CREATE TABLE session (id TEXT PRIMARY KEY, owner TEXT NOT NULL, front BLOB NOT NULL, op TEXT NOT NULL,
    args BLOB NOT NULL, data BLOB NOT NULL, checksum INTEGER NOT NULL, whole INTEGER NOT NULL);
CREATE TABLE trajectory (session TEXT NOT NULL, seq INTEGER NOT NULL, entry BLOB NOT NULL,
    PRIMARY KEY (session, seq)) WITHOUT ROWID;
"""

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.vault")


class BadState(Exception):
    """The state directory cannot be used; the text says why and what to do."""


@dataclass(slots=True)
class Saved:
    """A session as it is kept: what the front knows of it, plain; the operation that makes its state.

    ``entries`` are those of the trajectory since it was saved before, the newest one then among them; those
    before ``first_seq`` are gone. ``whole``: nothing has happened since.
    """

    id: str
    owner: str
    front: dict[str, Any]
    base: Operation
    entries: list[tuple[int, bytes]]
    first_seq: int
    whole: bool


class Vault:
    """Only :meth:`open`, :meth:`flush` and :meth:`close` wait for the disk."""

    def __init__(self, folder: Path, metrics: Metrics) -> None:
        self._folder, self._metrics = folder, metrics
        self._waiting: dict[str, Saved | None] = {}
        self._writing = self._closing = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="mfcmt-vault", daemon=True)
        self._db: sqlite3.Connection | None = None
        self._found: list[Saved] = []
        self._damaged: list[tuple[str, str]] = []

    def open(self) -> None:
        """Open and read; again, nothing more. Raises BadState."""
        if self._db is not None:
            return
        try:
            self._db = self._connect()
            self._read(self._db)
        except (OSError, sqlite3.Error) as broken:
            raise BadState(f"the state in {self._folder} cannot be used ({broken}): {_hint(broken)}") from broken
        self._thread.start()

    def take(self) -> tuple[list[Saved], list[tuple[str, str]]]:
        """The sessions that were found, in the order of their making, and ids and owners of damaged ones; once."""
        found, self._found = self._found, []
        damaged, self._damaged = self._damaged, []
        return found, damaged

    def save(self, saved: Saved) -> None:
        """Have a session written; of one that still waits only the newest state is."""
        with self._changed:
            before = self._waiting.get(saved.id)
            if before is not None:
                saved.entries = before.entries + saved.entries
            self._waiting[saved.id] = saved
            self._changed.notify_all()

    def forget(self, sid: str) -> None:
        """Have a session removed."""
        with self._changed:
            self._waiting[sid] = None
            self._changed.notify_all()

    def flush(self, timeout_s: float) -> bool:
        """Wait until everything is written; whether it is."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._waiting and not self._writing, timeout_s)

    def close(self) -> None:
        """Write what waits, if that can be done at once, and close."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        if self._thread.ident is not None:
            self._thread.join()
        if self._db is not None:
            self._db.close()

    def _connect(self) -> sqlite3.Connection:
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if self._folder.stat().st_mode & 0o007:
            log.warning("the state directory is open to every user", folder=str(self._folder))
        path = self._folder / FILE
        # SQLite gives its other files the mode of this one.
        os.close(os.open(path, os.O_CREAT | os.O_RDWR, 0o600))
        path.chmod(0o600)
        db = sqlite3.connect(path, timeout=LOCK_TIMEOUT_S, isolation_level=None, check_same_thread=False)
        for pragma in ("locking_mode=EXCLUSIVE", "journal_mode=WAL", "synchronous=NORMAL", "secure_delete=FAST"):
            db.execute(f"PRAGMA {pragma}")
        db.execute("BEGIN EXCLUSIVE")
        version = db.execute("PRAGMA user_version").fetchone()[0]
        if version == 0:
            for statement in SCHEMA.split(";"):
                db.execute(statement)
            db.execute(f"PRAGMA user_version={VERSION}")
        db.execute("COMMIT")
        if version not in (0, VERSION):
            raise sqlite3.DatabaseError(f"version {version} is not read here")
        return db

    def _read(self, db: sqlite3.Connection) -> None:
        for sid, owner, front, op, args, data, checksum, whole in db.execute("SELECT * FROM session ORDER BY rowid"):
            if _checksum(front, args, data) != checksum:
                log.error("saved session is damaged", session=sid)
                self._damaged.append((sid, owner))
                continue
            known = msgpack.unpackb(front)
            entries = db.execute(
                "SELECT seq, entry FROM trajectory WHERE session = ? AND seq <= ? ORDER BY seq", (sid, known["seq"])
            ).fetchall()
            base = Operation(op, msgpack.unpackb(args), data)
            self._found.append(Saved(sid, owner, known, base, entries, 0, bool(whole)))
        db.execute("BEGIN")
        db.execute("UPDATE session SET whole = 0")
        for sid, _ in self._damaged:
            _remove(db, sid)
        db.execute("COMMIT")

    def _run(self) -> None:
        assert self._db is not None
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closing)
                if not self._waiting:
                    return
                batch, self._waiting, self._writing = self._waiting, {}, True
            started = time.monotonic()
            try:
                _write(self._db, batch)
                self._metrics.state_write_seconds.observe(time.monotonic() - started)
            except sqlite3.Error as failed:
                self._metrics.state_write_failures.inc()
                log.error("sessions cannot be written", fault=str(failed), sessions=len(batch))
                self._put_back(batch)
            finally:
                with self._changed:
                    self._writing = False
                    self._changed.notify_all()

    def _put_back(self, batch: dict[str, Saved | None]) -> None:
        with self._changed:
            newer, self._waiting = self._waiting, batch
        for sid, saved in newer.items():
            self.save(saved) if saved is not None else self.forget(sid)
        with self._changed:
            if self._closing:
                self._waiting = {}
            self._changed.wait_for(lambda: self._closing, RETRY_S)


def _hint(broken: Exception) -> str:
    if "locked" in str(broken):
        return "another process uses it"
    if isinstance(broken, OSError) or "readonly" in str(broken) or "unable to open" in str(broken):
        return "this user must be able to write there"
    return "move it away to start without"


def _write(db: sqlite3.Connection, batch: dict[str, Saved | None]) -> None:
    db.execute("BEGIN")
    try:
        for sid, saved in batch.items():
            if saved is None:
                _remove(db, sid)
            else:
                _put(db, saved)
        db.execute("COMMIT")
    except BaseException:
        if db.in_transaction:
            db.execute("ROLLBACK")
        raise


def _put(db: sqlite3.Connection, saved: Saved) -> None:
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
