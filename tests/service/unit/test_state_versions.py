"""State directories of earlier versions are read, and those of later ones are refused."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import msgpack
import pytest

from service.observability.metrics import Metrics
from service.protocol.requests import Options
from service.protocol.target import ROW_FIELDS
from service.sessions.sqlite_store import SqliteStore
from service.sessions.state_file import FILE, SCHEMA, StateDirError
from service.sessions.store import SessionRecord
from service.sessions.trajectory import TrajectoryLog, unpacked

ROW_OF_VERSION_1 = [0, [1.0, 2.0, 3.0, 4.0], "tracking", True, None, None, 12.5, True, 1.0]
FRONT_OF_VERSION_1 = {
    "options": ["paper", "rescale", "label", True, 60.0],
    "created_at": "2026-01-02T03:04:05.678901+00:00",
    "seq": 7,
    "last_number": 9,
    "size": [640, 480],
    "region": None,
    "rows": [ROW_OF_VERSION_1],
}


def version_of(folder: Path) -> int:
    with closing(sqlite3.connect(folder / FILE)) as db:
        version: int = db.execute("PRAGMA user_version").fetchone()[0]
    return version


def write(folder: Path, version: int) -> None:
    with closing(sqlite3.connect(folder / FILE)) as db:
        db.executescript(SCHEMA)
        db.execute(f"PRAGMA user_version={version}")


def test_record_of_version_1_has_its_options_in_order() -> None:
    record = SessionRecord.from_dict(FRONT_OF_VERSION_1)
    assert record.options == Options("paper", 60.0, "rescale", "label", True)  # type: ignore[arg-type]
    assert record.created_at == datetime(2026, 1, 2, 3, 4, 5, 678901, UTC)
    assert (record.seq, record.last_number, record.rows) == (7, 9, [ROW_OF_VERSION_1])


def test_record_is_read_as_it_was_written() -> None:
    record = SessionRecord.from_dict(FRONT_OF_VERSION_1)
    assert SessionRecord.from_dict(msgpack.unpackb(msgpack.packb(record.to_dict()))) == record


def test_trajectory_of_an_earlier_version_has_all_fields() -> None:
    log = TrajectoryLog(1 << 20)
    log.append_packed(0, msgpack.packb((None, [640, 480], None, [ROW_OF_VERSION_1[:-1]])))
    (entry,) = unpacked(log.after(-1))
    assert [len(row) for row in entry.rows] == [len(ROW_FIELDS)]


def test_file_of_version_1_becomes_version_2_when_it_is_taken_over(tmp_path: Path) -> None:
    write(tmp_path, 1)
    store = SqliteStore(tmp_path, Metrics())
    store.open()
    store.close()
    assert version_of(tmp_path) == 1
    store = SqliteStore(tmp_path, Metrics())
    store.take_over()
    store.close()
    assert version_of(tmp_path) == 2


def test_file_of_a_later_version_is_refused_and_stays_as_it_is(tmp_path: Path) -> None:
    write(tmp_path, 3)
    with pytest.raises(StateDirError, match="version 3 is not read here"):
        SqliteStore(tmp_path, Metrics()).open()
    assert version_of(tmp_path) == 3
