"""What every database of sessions does: the same tests for SQLite and for a real Redis."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from service.cluster.redis_store import Node, RedisStore
from service.observability.metrics import Metrics
from service.protocol.enums import EndReason
from service.sessions.database import Ended, SavedSession, SessionDatabase
from service.sessions.replay_log import Operation
from service.sessions.sqlite_store import SqliteStore
from tests.service.cluster.redis_server import RedisServer

WAIT_S = 30.0
# As a node names its first claims, and above all of them.
FIRST = 1


def sqlite(folder: Path) -> Callable[[], SqliteStore]:
    return lambda: SqliteStore(folder, Metrics())


def shared(url: str) -> Callable[[], RedisStore]:
    names = iter("abcdefgh")
    return lambda: RedisStore(url, Node(next(names), "1", "http://node"), Metrics(), every_s=0.0, remember_s=60.0)


@pytest.fixture(params=["sqlite", "redis"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[SessionDatabase]:
    with ExitStack() as stack:
        if request.param == "redis":
            make: Callable[[], SessionDatabase] = shared(stack.enter_context(RedisServer()).url)
        else:
            make = sqlite(tmp_path)
        opened = make()
        opened.open()
        opened.take_over()
        yield stack.enter_context(closing(opened))


def saved(sid: str, epoch: int, seqs: range = range(1), *, first_seq: int = 0, state: bytes = b"state") -> SavedSession:
    entries = deque((seq, b"entry %d" % seq) for seq in seqs)
    checkpoint = Operation("revive", {"seq": seqs[-1]}, state)
    return SavedSession(sid, "me", {"seq": seqs[-1]}, checkpoint, entries, first_seq, False, epoch, 60.0)


def test_what_was_saved_is_claimed_as_it_was(database: SessionDatabase) -> None:
    database.save(saved("s", FIRST, range(3)))
    assert database.flush(WAIT_S)
    claimed = database.claim("s")
    assert claimed is not None
    assert (claimed.id, claimed.owner, claimed.front, claimed.whole) == ("s", "me", {"seq": 2}, False)
    assert (claimed.checkpoint.op, dict(claimed.checkpoint.args)) == ("revive", {"seq": 2})
    assert bytes(claimed.checkpoint.data) == b"state"
    assert list(claimed.entries) == [(seq, b"entry %d" % seq) for seq in range(3)]


def test_the_newest_result_is_replaced_and_old_ones_go(database: SessionDatabase) -> None:
    database.save(saved("s", FIRST, range(4)))
    assert database.flush(WAIT_S)
    later = saved("s", FIRST, range(3, 6), first_seq=2)
    later.entries[0] = (3, b"corrected")
    database.save(later)
    assert database.flush(WAIT_S)
    claimed = database.claim("s")
    assert claimed is not None
    assert list(claimed.entries) == [(2, b"entry 2"), (3, b"corrected"), (4, b"entry 4"), (5, b"entry 5")]


def test_every_claim_has_a_greater_epoch(database: SessionDatabase) -> None:
    database.save(saved("s", FIRST))
    claims = [database.claim("s") for _ in range(3)]
    epochs = [claim.epoch for claim in claims if claim is not None]
    assert len(epochs) == 3
    assert sorted(set(epochs)) == epochs


def test_a_writer_whose_claim_is_late_changes_nothing(database: SessionDatabase) -> None:
    database.save(saved("s", FIRST))
    late = database.claim("s")
    now = database.claim("s")
    assert late is not None
    assert now is not None
    database.save(saved("s", now.epoch, range(2), state=b"of the successor"))
    assert database.flush(WAIT_S)
    database.save(saved("s", late.epoch, range(9), state=b"of the dead"))
    assert database.flush(WAIT_S)
    database.delete("s", Ended("me", late.epoch, EndReason.CLOSED))
    database.flush(WAIT_S)
    again = database.claim("s")
    if isinstance(database, RedisStore):  # in SQLite the process that deletes is the only one
        assert again is not None
        assert bytes(again.checkpoint.data) == b"of the successor"


def test_what_is_forgotten_cannot_be_claimed(database: SessionDatabase) -> None:
    database.save(saved("s", FIRST))
    assert database.flush(WAIT_S)
    claimed = database.claim("s")
    assert claimed is not None
    database.delete("s", Ended("me", claimed.epoch, EndReason.CLOSED))
    assert database.flush(WAIT_S)
    assert database.claim("s") is None
    assert database.claim("never was") is None


def test_a_session_of_a_living_node_is_not_claimed(redis_server: RedisServer) -> None:
    from service.cluster.membership import Load, Membership

    make = shared(redis_server.url)
    with closing(make()) as first, closing(make()) as second:
        for store in (first, second):
            store.take_over()
        alive = Membership(first)
        alive.renew(Load())
        first.save(saved("led", FIRST))
        assert first.flush(WAIT_S)
        assert second.claim("led") is None
        found = second.whereabouts("led")
        assert found is not None
        assert found.node is not None
        assert found.node.name == first.node.name
        alive.leave()
        claimed = second.claim("led")
        assert claimed is not None
        assert first.late({"led": FIRST}) == (["led"], [])


def test_a_late_writer_is_told(redis_server: RedisServer) -> None:
    make = shared(redis_server.url)
    told: list[str] = []
    with closing(make()) as first, closing(make()) as second:
        first.on_late = told.extend
        for store in (first, second):
            store.take_over()
        first.save(saved("told", FIRST))
        assert first.flush(WAIT_S)
        assert second.claim("told") is not None
        first.save(saved("told", FIRST, range(2)))
        assert first.flush(WAIT_S)
    assert told == ["told"]


def test_the_reason_of_an_end_is_known_to_all(redis_server: RedisServer) -> None:
    make = shared(redis_server.url)
    with closing(make()) as first, closing(make()) as second:
        first.take_over()
        first.save(saved("ended", FIRST))
        assert first.flush(WAIT_S)
        first.delete("ended", Ended("me", FIRST, EndReason.IDLE, "nobody came"))
        assert first.flush(WAIT_S)
        found = second.whereabouts("ended")
        assert found is not None
        assert found.ended is not None
        assert (found.owner, found.ended.reason, found.ended.detail) == ("me", EndReason.IDLE, "nobody came")


def test_a_busy_session_is_written_once_in_a_while(redis_server: RedisServer) -> None:
    store = RedisStore(redis_server.url, Node("busy", "1", "http://node"), Metrics(), every_s=3600.0, remember_s=60.0)
    with closing(store):
        store.take_over()
        store.save(saved("busy", FIRST))
        assert store.flush(WAIT_S)
        for seq in range(1, 50):
            store.save(saved("busy", FIRST, range(seq - 1, seq + 1)))
        claimed = RedisStore(redis_server.url, Node("other", "1", "http://node"), Metrics(), every_s=0, remember_s=60)
        found = claimed.client.hget("{mfcmt}:session:busy", "front")
        assert found == b"\x81\xa3seq\x00"
        claimed.client.close()
        assert store.flush(WAIT_S)
        assert store.claim("busy").front == {"seq": 49}  # type: ignore[union-attr]
