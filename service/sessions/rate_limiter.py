"""Limits on the calls, frames and bytes per second of each key and of all keys together."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..settings import Settings

# Keys whose rates are remembered; beyond it the ones that were used longest ago are forgotten.
MAX_KEYS = 10_000
# The share of the common rate that is kept for keys which use little of their own.
RESERVE = 0.5
# The longest time by which the answer to a refused call is delayed.
MAX_DELAY_S = 1.0
ROUNDING = 1e-6


class TokenBucket:
    """Holds ``per_s`` tokens at most (at least 1) and gains ``per_s`` of them each second.

    ``now`` is in seconds of one monotonic clock in every call. The bucket may be in debt after :meth:`spend`.
    """

    def __init__(self, per_s: float, now: float) -> None:
        self._per_s = per_s
        self._size = max(1.0, per_s)
        self._tokens = self._size
        self._at = now

    def wait_s(self, now: float, reserve: float = 0.0) -> float:
        """Return the seconds until a token may be taken, 0 if one may be taken now.

        ``reserve`` is the share of the whole bucket, 0 to 1, that has to be left after it.
        """
        self._tokens = min(self._size, self._tokens + max(0.0, now - self._at) * self._per_s)
        self._at = now
        short = min(self._size, 1 + reserve * self._size) - self._tokens
        return short / self._per_s if short > ROUNDING else 0.0

    def take(self, now: float) -> float:
        """Take a token and return 0, or return the seconds until there is one."""
        if wait_s := self.wait_s(now):
            return wait_s
        self._tokens -= 1
        return 0.0

    def spend(self, amount: float) -> None:
        """Take ``amount`` tokens even if there are fewer; later callers wait until the debt is paid."""
        self._tokens -= amount

    @property
    def spent(self) -> float:
        """The share of the tokens that is gone, 0 to 1, at the time of the last call."""
        return 1 - max(0.0, self._tokens) / self._size


@dataclass(slots=True)
class KeyBuckets:
    """The buckets of one key."""

    calls: TokenBucket
    frames: TokenBucket
    bytes: TokenBucket
    refusals: TokenBucket


class RateLimiter:
    """Refuses what exceeds a rate at once; nothing is queued, and what is refused is not counted.

    A key above its own rate gets ``rate-limited``; a key that finds the common rate used up gets ``at-capacity``. The
    more of its own rate a key has used, the sooner it is refused when the common rate runs short.
    """

    def __init__(self, settings: Settings, clock: Callable[[], float]) -> None:
        self._settings, self._clock = settings, clock
        self._keys: OrderedDict[str, KeyBuckets] = OrderedDict()
        self._all_frames = TokenBucket(settings.max_frames_per_s, clock())
        self._all_bytes = TokenBucket(settings.max_frame_bytes_per_s, clock())

    def count_call(self, owner: str) -> None:
        """Count a call or handshake. Raises rate-limited."""
        now = self._clock()
        if wait_s := self._buckets(owner, now).calls.take(now):
            raise _rate_limited("calls", wait_s)

    def refusal_delay_s(self, owner: str) -> float:
        """Count a refusal, and return the seconds by which its answer is to be delayed: 0 within the rate."""
        now = self._clock()
        refusals = self._buckets(owner, now).refusals
        if (delay_s := refusals.wait_s(now)) < MAX_DELAY_S:
            refusals.spend(1)
        return min(delay_s, MAX_DELAY_S)

    def count_frame(self, owner: str, size: int = 0) -> None:
        """Count a frame of ``size`` bytes. Raises rate-limited, at-capacity; then nothing is counted."""
        now = self._clock()
        buckets = self._buckets(owner, now)
        if wait_s := buckets.frames.wait_s(now):
            raise _rate_limited("frames", wait_s)
        if wait_s := buckets.bytes.wait_s(now):
            raise _rate_limited("bytes", wait_s)
        if self._all_frames.wait_s(now, RESERVE) or self._all_bytes.wait_s(now, RESERVE):  # seldom: it runs short
            wait_s = max(
                self._all_frames.wait_s(now, RESERVE * buckets.frames.spent),
                self._all_bytes.wait_s(now, RESERVE * buckets.bytes.spent),
            )
            if wait_s:
                detail = "the service receives more frames than it can take"
                raise ProblemError(ProblemCode.AT_CAPACITY, detail, retry_after_s=_retry_after_s(wait_s))
        buckets.frames.spend(1)
        buckets.bytes.spend(size)
        self._all_frames.spend(1)
        self._all_bytes.spend(size)

    def count_bytes(self, owner: str, size: int) -> None:
        """Count ``size`` bytes of a frame that has been counted already."""
        self._buckets(owner, self._clock()).bytes.spend(size)
        self._all_bytes.spend(size)

    def _buckets(self, owner: str, now: float) -> KeyBuckets:
        buckets = self._keys.get(owner)
        if buckets is None:
            settings = self._settings
            buckets = self._keys[owner] = KeyBuckets(
                TokenBucket(settings.max_requests_per_s, now),
                TokenBucket(settings.max_frames_per_s_per_key, now),
                TokenBucket(settings.max_frame_bytes_per_s_per_key, now),
                TokenBucket(settings.max_refusals_per_s, now),
            )
            while len(self._keys) > MAX_KEYS:
                self._keys.popitem(last=False)
        self._keys.move_to_end(owner)
        return buckets


def _rate_limited(what: str, wait_s: float) -> ProblemError:
    return ProblemError(ProblemCode.RATE_LIMITED, f"too many {what}", retry_after_s=_retry_after_s(wait_s))


def _retry_after_s(wait_s: float) -> float:
    return max(0.001, round(wait_s, 3))
