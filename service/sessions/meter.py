"""What each key and all of them together use a second: calls, frames, bytes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from ..problems import ProblemError
from ..settings import Settings
from .bucket import Bucket

MAX_ACCOUNTS = 10_000
# Of what all keys share, this much is kept for those that use little of their own.
RESERVE = 0.5
# A refusal that comes late is not later than this.
MAX_LATE_S = 1.0


@dataclass(slots=True)
class Account:
    """The buckets of one key."""

    calls: Bucket
    frames: Bucket
    bytes: Bucket
    refusals: Bucket


class Meter:
    """Refuses at once and queues nothing; a refusal costs nobody anything.

    A key above its own rate is told ``rate-limited``, whoever finds the common rate used up ``at-capacity``.
    The more a key has used of its own rate, the sooner it is refused of the common one.
    """

    def __init__(self, settings: Settings, clock: Callable[[], float]) -> None:
        self._settings, self._clock = settings, clock
        self._accounts: OrderedDict[str, Account] = OrderedDict()
        self._all = (
            Bucket(settings.max_frames_per_s, clock()),
            Bucket(settings.max_frame_bytes_per_s, clock()),
        )

    def call(self, owner: str) -> None:
        """Count a call or handshake. Raises rate-limited."""
        now = self._clock()
        if wait_s := self._account(owner, now).calls.take(now):
            raise _too_many("calls", wait_s)

    def refusal(self, owner: str) -> float:
        """Count a refusal: 0, or the seconds that it is above the rate; they do not grow beyond some."""
        now = self._clock()
        refusals = self._account(owner, now).refusals
        if (late_s := refusals.wait_s(now)) < MAX_LATE_S:
            refusals.spend(1)
        return min(late_s, MAX_LATE_S)

    def frame(self, owner: str, size: int = 0) -> None:
        """Count a frame of ``size`` bytes, or nothing of it. Raises rate-limited, at-capacity."""
        now = self._clock()
        account = self._account(owner, now)
        frames, data = self._all
        if wait_s := account.frames.wait_s(now):
            raise _too_many("frames", wait_s)
        if wait_s := account.bytes.wait_s(now):
            raise _too_many("bytes", wait_s)
        wait_s = max(
            frames.wait_s(now, RESERVE * account.frames.spent), data.wait_s(now, RESERVE * account.bytes.spent)
        )
        if wait_s:
            told = "the service has more frames than it takes"
            raise ProblemError("at-capacity", told, retry_after_s=_told(wait_s))
        account.frames.spend(1)
        frames.spend(1)
        self.add_bytes(owner, size)

    def add_bytes(self, owner: str, size: int) -> None:
        """Count bytes of a frame that has been counted already."""
        self._account(owner, self._clock()).bytes.spend(size)
        self._all[1].spend(size)

    def _account(self, owner: str, now: float) -> Account:
        account = self._accounts.get(owner)
        if account is None:
            settings = self._settings
            account = self._accounts[owner] = Account(
                Bucket(settings.max_requests_per_s, now),
                Bucket(settings.max_frames_per_s_per_key, now),
                Bucket(settings.max_frame_bytes_per_s_per_key, now),
                Bucket(settings.max_refusals_per_s, now),
            )
            while len(self._accounts) > MAX_ACCOUNTS:
                self._accounts.popitem(last=False)
        self._accounts.move_to_end(owner)
        return account


def _too_many(what: str, wait_s: float) -> ProblemError:
    return ProblemError("rate-limited", f"too many {what}", retry_after_s=_told(wait_s))


def _told(wait_s: float) -> float:
    return max(0.001, round(wait_s, 3))
