"""Rates with a clock of their own: what is let through, who is refused first, what it costs to remember."""

from __future__ import annotations

import sys

import pytest

from service.protocol.problems import ProblemError
from service.sessions.rate_limiter import RateLimiter, TokenBucket
from service.settings import Settings


class Clock:
    """Seconds that pass when told to."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def taken(rate_limiter: RateLimiter, owner: str, times: int, size: int = 0) -> int:
    """How many of ``times`` frames are let through."""
    through, waits = 0, []
    for _ in range(times):
        try:
            rate_limiter.count_frame(owner, size)
            through += 1
        except ProblemError as refused:
            waits.append(refused.members["retry_after_s"])
    assert all(wait_s > 0 for wait_s in waits)
    return through


def test_key_above_its_rate_is_told_when_to_return() -> None:
    clock = Clock()
    rate_limiter = RateLimiter(Settings(max_frames_per_s_per_key=10), clock)
    assert taken(rate_limiter, "a", 25) == 10
    with pytest.raises(ProblemError) as refused:
        rate_limiter.count_frame("a")
    assert refused.value.code == "rate-limited"
    clock.now += refused.value.members["retry_after_s"]
    assert taken(rate_limiter, "a", 5) == 1
    clock.now += 3600
    assert taken(rate_limiter, "a", 25) == 10
    assert taken(rate_limiter, "b", 25) == 10


def test_a_long_run_keeps_to_the_rate() -> None:
    clock = Clock()
    rate_limiter = RateLimiter(Settings(max_frames_per_s_per_key=100, max_frame_bytes_per_s_per_key=5000), clock)
    through = 0
    for _ in range(10_000):
        clock.now += 0.01
        through += taken(rate_limiter, "a", 3, 100)
    assert through == pytest.approx(50 * 100, rel=0.03)  # the bytes are the scarcer


def test_large_frame_leaves_debt_of_bytes() -> None:
    """A frame larger than a second's bytes passes, and the next one waits for it."""
    clock = Clock()
    rate_limiter = RateLimiter(Settings(max_frame_bytes_per_s_per_key=1000), clock)
    rate_limiter.count_frame("a", 5000)
    with pytest.raises(ProblemError) as refused:
        rate_limiter.count_frame("a", 1)
    assert refused.value.members["retry_after_s"] == pytest.approx(4.0, abs=0.01)
    clock.now += 4.01
    rate_limiter.count_frame("a", 1)


def test_refused_frame_is_not_counted() -> None:
    clock = Clock()
    rate_limiter = RateLimiter(Settings(max_frames_per_s=100, max_frames_per_s_per_key=10), clock)
    assert taken(rate_limiter, "flood", 10_000) == 10
    assert sum(taken(rate_limiter, f"key {n}", 10) for n in range(4)) == 40


def test_modest_key_passes_beside_floods() -> None:
    """Two keys together would use the common rate up; a third that sends 30 a second loses nothing."""
    clock = Clock()
    rate_limiter = RateLimiter(Settings(max_frames_per_s=1000, max_frames_per_s_per_key=800), clock)
    victim = floods = 0
    for tick in range(3000):
        clock.now += 0.01
        floods += taken(rate_limiter, "first", 10) + taken(rate_limiter, "second", 10)
        if tick % 3 == 0:
            victim += taken(rate_limiter, "victim", 1)
    assert victim == 1000
    assert 0.9 * 30_000 < floods + victim <= 31_000


def test_exceeded_common_rate_is_at_capacity() -> None:
    rate_limiter = RateLimiter(Settings(max_frames_per_s=5, max_frames_per_s_per_key=50), Clock())
    taken(rate_limiter, "a", 50)
    with pytest.raises(ProblemError) as refused:
        rate_limiter.count_frame("a")
    assert (refused.value.code, refused.value.status) == ("at-capacity", 503)


def test_clock_that_stands_or_steps_back_adds_no_tokens() -> None:
    bucket = TokenBucket(10, 100.0)
    assert [bucket.take(100.0) for _ in range(10)] == [0.0] * 10
    assert bucket.take(50.0) > 0
    assert bucket.take(50.05) > 0


def test_remembered_keys_are_small_and_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.sessions.rate_limiter.MAX_KEYS", 100)
    clock = Clock()
    rate_limiter = RateLimiter(Settings(max_requests_per_s=2), clock)
    for n in range(5000):
        rate_limiter.count_call("busy")
        rate_limiter.count_call(f"key {n}")
        clock.now += 1
    assert len(rate_limiter._keys) == 100
    assert "busy" in rate_limiter._keys
    account = rate_limiter._keys["busy"]
    parts = (account, account.calls, account.frames, account.bytes)
    assert sum(sys.getsizeof(part) + sys.getsizeof(getattr(part, "__dict__", 0)) for part in parts) < 2000
