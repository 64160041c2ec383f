"""Decides whether a new session is admitted, and gives it its place in a lane."""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping

from ..lanes.interface import AtCapacity, Lanes
from ..observability.metrics import Metrics
from ..protocol.enums import ProblemCode
from ..protocol.problems import NO_LANE, NO_PLACE, ProblemError
from ..settings import Settings
from .session import Session
from .store import SessionStore

# When a place becomes free is not known while all sessions are used: streams go on for as long as their clients like.
UNKNOWN_WAIT_S = 10.0
LEAST_WAIT_S = 1.0


class KeyQuotas:
    """The number of sessions and streams that one key may have, where the settings do not say it.

    A single owner may have all of them, and each of several owners half: so one key never takes every place from the
    others, and a service with one key, or without keys, can be used to the full. ``owners`` returns their number now.
    """

    def __init__(self, settings: Settings, owners: Callable[[], int]) -> None:
        self._settings, self._owners = settings, owners

    @property
    def sessions(self) -> int:
        """Sessions of one key."""
        return self._settings.max_sessions_per_key or self._share(self._settings.capacity)

    @property
    def streams(self) -> int:
        """Attached streams of one key."""
        return self._settings.max_streams_per_key or self._share(self._settings.max_streams)

    def _share(self, whole: int) -> int:
        return whole if self._owners() < 2 else max(1, whole // 2)


class Admission:
    """Admits a session at once or refuses it; nothing is queued.

    ``sessions`` are those that live, by id; ``sweep`` ends those of them that are overdue, which makes room;
    ``seconds_left`` returns how long a session lives if it is not used again.
    """

    def __init__(
        self,
        settings: Settings,
        lanes: Lanes,
        metrics: Metrics,
        quotas: KeyQuotas,
        store: SessionStore,
        sessions: Mapping[str, Session],
        sweep: Callable[[], None],
        seconds_left: Callable[[Session], float],
    ) -> None:
        self.draining = False
        self._settings, self._lanes, self._metrics = settings, lanes, metrics
        self._quotas, self._store = quotas, store
        self._sessions, self._sweep, self._seconds_left = sessions, sweep, seconds_left
        self._starting: Counter[str] = Counter()

    @contextlib.contextmanager
    def place(self, session: Session) -> Iterator[None]:
        """Take a place in a lane for a session that starts in this block, and give it back if the block fails.

        Raises draining, over-quota, at-capacity; the last also if the lane is lost while the session starts.
        """
        self._reserve(session.id, session.owner)
        self._starting[session.owner] += 1
        try:
            yield
        except BaseException as failed:
            self._lanes.release(session.id)
            self._store.delete(session)
            if isinstance(failed, ProblemError) and failed.code == ProblemCode.SESSION_GONE:
                # For the client there never was a session.
                detail = "the lane of the session was lost while it started"
                raise self._refusal(ProblemCode.AT_CAPACITY, detail) from failed
            raise
        finally:
            self._starting -= Counter((session.owner,))

    def _reserve(self, sid: str, owner: str) -> None:
        if self.draining:
            retry_after_s = self._settings.drain_grace_s
            raise self._refusal(ProblemCode.DRAINING, "the service is going away", retry_after_s)
        self._check_quota(owner)
        if self._store.budget.spent(owner):
            raise self._refusal(ProblemCode.AT_CAPACITY, "no memory for another session of this key")
        try:
            self._lanes.reserve(sid, owner)
        except AtCapacity:
            self._sweep()
            try:
                self._lanes.reserve(sid, owner)
            except AtCapacity:
                if not any(lane.ready for lane in self._lanes.status()):
                    raise self._refusal(ProblemCode.AT_CAPACITY, NO_LANE) from None
                raise self._full() from None

    def _check_quota(self, owner: str) -> None:
        """Raises over-quota for an owner with as many sessions as it may have, including those that start."""
        most = self._quotas.sessions
        if most >= self._settings.capacity or self._count(owner) < most:
            return
        self._sweep()
        if self._count(owner) >= most:
            raise self._refusal(ProblemCode.OVER_QUOTA, f"at most {most} sessions of a key")

    def _count(self, owner: str) -> int:
        return self._starting[owner] + sum(session.owner == owner for session in self._sessions.values())

    def _full(self) -> ProblemError:
        """Return the refusal of a session that finds no place, and when the first one ends that nobody uses."""
        sessions = self._sessions.values()
        unused = [self._seconds_left(one) for one in sessions if one.attachment is None and not one.busy]
        if not unused:
            return self._refusal(ProblemCode.AT_CAPACITY, f"{NO_PLACE}: all are in use", UNKNOWN_WAIT_S)
        wait_s = max(LEAST_WAIT_S, math.ceil(min(unused)))
        detail = f"{NO_PLACE}: one that nobody uses ends in {wait_s:.0f} s, if not earlier"
        return self._refusal(ProblemCode.AT_CAPACITY, detail, wait_s)

    def _refusal(self, code: ProblemCode, detail: str, retry_after_s: float = LEAST_WAIT_S) -> ProblemError:
        self._metrics.refused_sessions.labels(reason=code).inc()
        return ProblemError(code, detail, retry_after_s=retry_after_s)
