"""What bounds bytes, refusals, log lines and large work; the highest lateness; the memory of the container."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from prometheus_client import CollectorRegistry, Histogram

from service.api.trajectory import ROWS_AT_ONCE, _some
from service.container import LEAST, MOST, budget_bytes, usable_memory
from service.observability.lag import WINDOW_S, Lag
from service.observability.sampled import LINES_A_SECOND, Sampled
from service.protocol.documents import MAX_ITEMS_IN_ALL, MAX_TEXT_BYTES, Unreadable, from_json, from_msgpack, to_msgpack
from service.protocol.enums import Mode
from service.protocol.problems import ProblemError
from service.sessions.byte_budget import ANONYMOUS, ByteBudget, Reservation
from service.sessions.concurrency import ConcurrencyLimit
from service.sessions.interface import QueuedFrame
from service.sessions.rate_limiter import MAX_DELAY_S, RateLimiter
from service.sessions.trajectory import TrajectoryEntry
from service.settings import Settings
from service.stream.frame_queue import FrameQueue


class Clock:
    """Stands where it is put."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def test_single_owner_gets_half_of_the_budget() -> None:
    budget = ByteBudget(120)
    first, second, third = (Reservation(budget, owner) for owner in ("a", "b", "c"))
    assert not first.resize(61)
    assert first.resize(60)
    assert second.resize(30)
    assert not second.resize(31)
    assert third.resize(15)
    with pytest.raises(ProblemError, match="at-capacity"):
        first.grow(1)
    first.resize(0)
    assert second.resize(50)


def test_held_bytes_move_with_their_owner() -> None:
    budget = ByteBudget(100)
    share = Reservation(budget)
    assert share.resize(40)
    share.assign("a")
    assert Reservation(budget, ANONYMOUS).resize(30)
    assert not Reservation(budget, "a").resize(1)
    share.resize(0)
    assert budget.held == 30


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 80)), max_size=60))
def test_byte_budget_counts_right_for_any_sequence(steps: list[tuple[int, int]]) -> None:
    budget = ByteBudget(100)
    shares, held = [Reservation(budget, str(n % 2)) for n in range(4)], [0] * 4
    for who, size in steps:
        if shares[who].resize(size):
            held[who] = size
        assert budget.held == sum(held) <= 100
    for share in shares:
        share.resize(0)
    assert (budget.held, budget._held_by) == (0, {})


@pytest.mark.parametrize("mode", list(Mode))
def test_frames_that_wait_count_until_they_are_answered(mode: Mode) -> None:
    budget = ByteBudget(100)
    queue = FrameQueue(mode, 4, lambda: None, Reservation(budget, "a"))

    def put(seq: int, size: int) -> None:
        queue.put_frame(QueuedFrame(bytes(size), seq, None, None, 0.0, 0.0), [])

    async def scenario() -> None:
        put(1, 30)
        job = await queue.next()
        put(2, 20)
        with pytest.raises(ProblemError, match="at-capacity"):
            put(3, 45)
        queue.answered(job)
        assert budget.held == 20
        put(4, 25)
        assert budget.held == (25 if mode == "latest" else 45)
        job = await queue.next()
        queue.discard()
        queue.answered(job)
        assert budget.held == 0
        queue.close()

    asyncio.run(scenario())
    assert budget.held == 0


def test_refusals_above_their_rate_come_late_and_not_ever_later() -> None:
    clock = Clock()
    meter = RateLimiter(Settings(max_refusals_per_s=10), clock)
    assert [meter.refusal_delay_s("a") for _ in range(10)] == [0.0] * 10
    assert meter.refusal_delay_s("a") > 0
    assert meter.refusal_delay_s("b") == 0
    for _ in range(1000):
        late_s = meter.refusal_delay_s("a")
    assert late_s == MAX_DELAY_S
    clock.now += MAX_DELAY_S + 1
    assert meter.refusal_delay_s("a") == 0


async def test_concurrency_limit_holds_for_each_key() -> None:
    limit, release = ConcurrencyLimit(2, 0.01, "snapshots"), asyncio.Event()

    async def work() -> None:
        async with limit.slot("a"):
            await release.wait()

    working = [asyncio.ensure_future(work()) for _ in range(2)]
    await asyncio.sleep(0)
    with pytest.raises(ProblemError, match="at most 2 snapshots of a key at once"):
        async with limit.slot("a"):
            pass
    async with limit.slot("b"):
        pass
    release.set()
    await asyncio.gather(*working)
    async with limit.slot("a"):
        pass
    assert not limit._owners


def test_lines_that_a_stranger_causes_are_counted_and_not_all_written() -> None:
    lines: list[dict[str, Any]] = []

    class Log:
        def info(self, event: str, **fields: Any) -> None:
            lines.append({"event": event, **fields})

    clock = Clock()
    log = Sampled(Log(), clock)  # type: ignore[arg-type]
    for _ in range(1000):
        log.info("call", code="unauthenticated")
    assert len(lines) == LINES_A_SECOND
    log.info("call", code="rate-limited")
    clock.now += 1
    log.info("call", code="unauthenticated")
    assert lines[-1] == {"event": "call", "code": "unauthenticated", "left_out": 1000 - LINES_A_SECOND}


def test_a_stall_is_told_for_half_a_minute_at_least_and_then_forgotten() -> None:
    clock = Clock()
    lag = Lag(Histogram("late", "", registry=CollectorRegistry()), clock)
    lag.observe(8.0)
    for _ in range(int(WINDOW_S / 0.025)):
        clock.now += 0.025
        lag.observe(0.001)
        assert lag.highest_s == 8.0
    clock.now += 2 * WINDOW_S
    lag.observe(0.002)
    assert lag.highest_s == 0.002


def test_the_byte_budget_follows_the_containers_memory(tmp_path: Path) -> None:
    assert usable_memory(tmp_path) == usable_memory()
    (tmp_path / "memory").mkdir()
    (tmp_path / "memory" / "memory.limit_in_bytes").write_text("1073741824\n")
    assert usable_memory(tmp_path) == 1 << 30
    (tmp_path / "memory.max").write_text("2147483648\n")
    assert usable_memory(tmp_path) == 2 << 30
    (tmp_path / "memory.max").write_text("max\n")
    assert usable_memory(tmp_path) == usable_memory(tmp_path / "nowhere")
    assert LEAST <= budget_bytes() <= MOST
    assert Settings().max_upload_bytes == budget_bytes()


def test_documents_of_too_many_items_are_refused_unread() -> None:
    for many in (b"1,", b"[],", b"{},", b'{"a":1},'):
        with pytest.raises(Unreadable, match="too many items"):
            from_json(b"[" + many * MAX_ITEMS_IN_ALL + b"1]")
        with pytest.raises(Unreadable, match="too many items"):
            from_json("[" + many.decode() * MAX_ITEMS_IN_ALL + "1]")
    frame = "a" * 400_000
    assert from_json(f'{{"frame":"{frame}"}}') == {"frame": frame}
    with pytest.raises(Unreadable):
        from_msgpack(to_msgpack({"a": "a" * (MAX_TEXT_BYTES + 1)}))


@given(st.lists(st.integers(0, 300), max_size=50))
def test_parts_of_a_past_are_small_by_their_targets(targets: list[int]) -> None:
    entries = [TrajectoryEntry(n, None, [1, 1], None, [[0]] * count) for n, count in enumerate(targets)]
    parts = list(_some(iter(entries)))
    assert [entry for part in parts for entry in part] == entries
    for part in parts:
        assert sum(1 + len(entry.rows) for entry in part[:-1]) < ROWS_AT_ONCE
