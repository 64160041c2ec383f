"""The state directory: nothing of an ended session stays in it, and a disk that is full costs a bounded memory."""

from __future__ import annotations

import random
import resource
import shutil
import sqlite3
import time
from collections import deque
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import msgpack
import pytest
from prometheus_client import generate_latest
from structlog.testing import capture_logs

from service.observability.metrics import Metrics
from service.sessions import database as databases
from service.sessions.database import SavedSession
from service.sessions.replay_log import Operation
from service.sessions.sqlite_store import SqliteStore
from service.sessions.state_file import FILE, SCHEMA, StateDirError

PIECE = 48


def opened(folder: Path) -> SqliteStore:
    database = SqliteStore(folder, Metrics())
    database.take_over()
    return database


def saved(sid: str, frame: bytes, seqs: range = range(1), first_seq: int = 0) -> SavedSession:
    entries = deque((seq, b"entry %d" % seq) for seq in seqs)
    front = {"seq": seqs[-1]}
    return SavedSession(sid, "me", front, Operation("revive", {}, b"state" + frame), entries, first_seq, whole=False)


def frames(count: int, seed: int = 1) -> list[bytes]:
    """Bytes of the sizes of frames and checkpoints, no piece of which comes twice."""
    source = random.Random(seed)
    return [source.randbytes(source.choice((900, 3_000, 12_000, 60_000, 700_000))) for _ in range(count)]


def remains(folder: Path, frames: list[bytes]) -> int:
    """Of how many frames a piece is in any file of the folder."""
    held = [file.read_bytes() for file in folder.iterdir()]
    return sum(
        any(
            frame[at : at + PIECE] in data
            for at in range(0, len(frame) - PIECE, max(400, len(frame) // 200))
            for data in held
        )
        for frame in frames
    )


@dataclass
class Before:
    """A row of the file, before it is packed."""

    id: str
    owner: str
    front: dict[str, Any]
    op: str
    args: dict[str, Any]
    data: bytes
    past: bytes = b"entry"


def as_before(folder: Path, kept: list[Before], ended: list[Before]) -> None:
    """The file as the version wrote it that left the bytes of ``ended`` sessions in free pages."""
    folder.mkdir(mode=0o700, exist_ok=True)
    with closing(sqlite3.connect(folder / FILE, isolation_level=None)) as db:
        for pragma in ("locking_mode=EXCLUSIVE", "journal_mode=WAL", "secure_delete=FAST"):
            db.execute(f"PRAGMA {pragma}")
        for statement in SCHEMA.split(";"):
            db.execute(statement)
        db.execute("PRAGMA user_version=1")
        for one in kept + ended:
            front, args = msgpack.packb(one.front), msgpack.packb(one.args)
            checksum = crc32(one.data, crc32(args, crc32(front)))
            row = (one.id, one.owner, front, one.op, args, one.data, checksum)
            db.execute("INSERT INTO session VALUES (?, ?, ?, ?, ?, ?, ?, 1)", row)
            db.execute("INSERT INTO trajectory VALUES (?, 0, ?)", (one.id, one.past))
        for one in ended:
            db.execute("DELETE FROM session WHERE id = ?", (one.id,))
            db.execute("DELETE FROM trajectory WHERE session = ?", (one.id,))


@pytest.mark.parametrize("others", [False, True], ids=["the last ones", "beside others"])
def test_nothing_of_an_ended_session_stays_on_disk(tmp_path: Path, others: bool) -> None:
    """While the service runs and after it stops, in the file, its free pages and its write-ahead log."""
    images = frames(12)
    database = opened(tmp_path)
    kept = frames(3, seed=2) if others else []
    for number, image in enumerate(images + kept):
        database.save(saved(f"s{number}", image))
        assert database.flush(20)
        # Newer states of the same session replace it.
        database.save(saved(f"s{number}", image[::-1]))
        database.save(saved(f"s{number}", image))
    assert database.flush(20)
    assert remains(tmp_path, images) == len(images)
    for number in range(len(images)):
        database.delete(f"s{number}")
    assert database.flush(20)
    gone = images + [image[::-1] for image in images]
    assert remains(tmp_path, gone) == 0
    assert remains(tmp_path, kept) == len(kept)
    database.close()
    assert remains(tmp_path, gone) == 0


def test_log_of_killed_process_is_erased_at_next_start(tmp_path: Path) -> None:
    images = frames(4)
    running, killed = tmp_path / "running", tmp_path / "killed"
    database = opened(running)
    for number, image in enumerate(images):
        database.save(saved(f"s{number}", image))
    assert database.flush(20)
    database._file.db.execute("DELETE FROM session")  # type: ignore[union-attr]
    shutil.copytree(running, killed)
    database.close()
    assert remains(killed, images) == len(images)
    database = opened(killed)
    assert remains(killed, images) == 0
    database.close()


def test_remains_of_an_earlier_version_are_erased_and_its_sessions_are_read(tmp_path: Path) -> None:
    kept, ended = frames(3), frames(8, seed=2)
    rows = [Before(f"s{n}", "me", {"seq": 0}, "revive", {}, data) for n, data in enumerate(kept + ended)]
    as_before(tmp_path, rows[: len(kept)], rows[len(kept) :])
    assert remains(tmp_path, ended) > 0
    database = SqliteStore(tmp_path, Metrics())
    database.open()
    found, damaged = database.load()
    assert [(one.id, one.checkpoint.data, one.whole, list(one.entries)) for one in found] == [
        (f"s{n}", data, True, [(0, b"entry")]) for n, data in enumerate(kept)
    ]
    assert damaged == []
    assert remains(tmp_path, ended) == 0
    database.close()


def fill_up(database: SqliteStore) -> Callable[[], None]:
    """Let the disk of an open database be full until what is returned is called."""
    assert database._file.db is not None
    (most,) = database._file.db.execute("PRAGMA max_page_count").fetchone()
    database._file.db.execute("PRAGMA max_page_count=1")
    return lambda: database._file.db.execute(f"PRAGMA max_page_count={most}")  # type: ignore[union-attr, return-value]


def failures(database: SqliteStore) -> float:
    text = generate_latest(database._metrics.registry).decode()
    return float(
        next(line for line in text.splitlines() if line.startswith("mfcmt_state_write_failures_total")).split()[1]
    )


def wait_for_failures(database: SqliteStore, count: int) -> None:
    """Wait until so many attempts to write have failed."""
    give_up = time.monotonic() + 60
    while failures(database) < count:
        assert time.monotonic() < give_up
        time.sleep(0.001)


def waiting_in(database: SqliteStore) -> dict[str, SavedSession | None]:
    """Return what waits to be written, at a moment between two attempts."""
    give_up = time.monotonic() + 60
    while time.monotonic() < give_up:
        with database._changed:
            if not database._batch:
                return dict(database._waiting)
        time.sleep(0.001)
    raise AssertionError("an attempt to write has no end")


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(databases, "RETRY_S", 0.01)


@pytest.mark.usefixtures("impatient")
def test_full_disk_costs_bounded_memory_and_one_log_line(tmp_path: Path) -> None:
    with capture_logs() as lines:
        database = opened(tmp_path)
        database.save(saved("lasting", frames(1)[0]))
        assert database.flush(20)
        make_room = fill_up(database)
        for seq in range(1, 2000):
            database.save(saved("lasting", b"x" * 100_000, range(seq - 1, seq + 1), first_seq=max(0, seq - 50)))
            database.save(saved(f"short{seq}", b"x" * 100_000))
            database.delete(f"short{seq}")
            if seq % 200 == 0:
                wait_for_failures(database, seq // 200)
        waiting = waiting_in(database)
        assert set(waiting) == {"lasting"}
        assert waiting["lasting"] is not None
        assert [seq for seq, _ in waiting["lasting"].entries] == list(range(1949, 2000))
        database.delete("lasting")
        make_room()
        assert database.flush(20)
        database.close()
    events = [line["event"] for line in lines]
    assert events.count("sessions cannot be written") == 1
    assert events.count("sessions are written again") == 1
    database = opened(tmp_path)
    assert database.load() == ([], [])
    database.close()


@pytest.mark.usefixtures("impatient")
def test_sessions_are_written_after_disk_failure(tmp_path: Path) -> None:
    """What could not be written is written later, together with what came meanwhile."""
    database = opened(tmp_path)
    make_room = fill_up(database)
    database.save(saved("a", b"x" * 100_000, range(2)))
    wait_for_failures(database, 1)
    database.save(saved("a", b"y" * 100_000, range(1, 3)))
    make_room()
    assert database.flush(20)
    database.close()
    database = opened(tmp_path)
    (one,), _ = database.load()
    assert one.checkpoint.data == b"state" + b"y" * 100_000
    assert [seq for seq, _ in one.entries] == [0, 1, 2]
    database.close()


@pytest.mark.usefixtures("impatient")
def test_store_that_could_not_write_says_so_when_closed(tmp_path: Path) -> None:
    database = opened(tmp_path)
    fill_up(database)
    database.save(saved("a", b"x" * 100_000))
    assert not database.flush(0.1)
    assert database.close() is False
    database = opened(tmp_path)
    database.save(saved("a", b"x" * 100_000))
    assert database.close() is True


def test_a_full_disk_at_the_start_says_what_to_do(tmp_path: Path) -> None:
    opened(tmp_path).close()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        with pytest.raises(StateDirError, match="cannot be used"):
            SqliteStore(tmp_path, Metrics()).open()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
