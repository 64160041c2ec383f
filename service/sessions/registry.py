"""The registry: every session, who owns it, when it ends and what is remembered of it."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import structlog

from ..lanes.interface import AtCapacity, KeysLost, LaneCrowded, Lanes
from ..observability.metrics import Metrics
from ..protocol.problems import NO_LANE, NO_PLACE, ProblemError, session_gone, session_not_found
from ..settings import Settings
from .idempotency import IdempotentCreations
from .quotas import KeyQuotas
from .session import Attachment, Options, Session
from .store import SessionStore, created_at_of, options_of
from .ttl_cache import TTLCache

SWEEP_EVERY_S = 0.5
ID_BYTES = 18
# How a stream is closed when its session ends.
CLOSE_CODES = {"closed": 1000, "idle": 4408, "expired": 4410, "lost": 4410}

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.sessions")


@dataclass(frozen=True, slots=True)
class Tombstone:
    """What is left of a session."""

    owner: str
    reason: str
    detail: str = ""


class SessionRegistry:
    """All sessions of the service.

    ``clock`` gives seconds of a monotonic clock, ``owners`` how many there are that keys stand for.
    """

    def __init__(
        self,
        settings: Settings,
        lanes: Lanes,
        metrics: Metrics,
        clock: Callable[[], float] = time.monotonic,
        owners: Callable[[], int] = lambda: 1,
    ) -> None:
        self.draining = False
        self.shares = KeyQuotas(settings, owners)
        self._settings, self._lanes, self._metrics, self._clock = settings, lanes, metrics, clock
        self.store = SessionStore(settings, lanes, metrics)
        self._sessions: dict[str, Session] = {}
        self._tombstones: TTLCache[Tombstone] = TTLCache(settings.max_tombstones, settings.tombstone_s, clock)
        self._creations = IdempotentCreations(settings.max_idempotency_keys, settings.idempotency_s, clock)
        self._opening: Counter[str] = Counter()
        self._ordinal = 0

    def __len__(self) -> int:
        return len(self._sessions)

    def find(self, owner: str, sid: str) -> Session:
        """The caller's session, which counts as used. Raises session-not-found, session-gone."""
        session = self._sessions.get(sid)
        if session is None or session.owner != owner:
            grave = self._tombstones.get(sid)
            if grave is None or grave.owner != owner:
                raise session_not_found()
            raise session_gone(grave.reason, grave.detail)
        if self._overdue(session):
            self._end(session, self._overdue(session))
            return self.find(owner, sid)
        session.touch()
        return session

    def list_owned(self, owner: str, after: int, limit: int) -> tuple[list[Session], int | None]:
        """The caller's sessions in the order of their making, and where the next page begins."""
        mine = [s for s in self._sessions.values() if s.owner == owner and s.ordinal > after]
        page = mine[:limit]
        return page, page[-1].ordinal if len(mine) > limit else None

    async def create(
        self, owner: str, data: bytes, boxes: list[list[float]], options: Options, key: str | None
    ) -> Session:
        """A session that has started on its first frame; the same one for the same ``key`` and content."""

        async def make() -> str:
            session = self._open(owner, options)
            with self._undone_on_error(session):
                await session.begin(data, boxes)
            return session.id

        return self.find(owner, await self._creations.once(owner, key, data, repr((boxes, options)), make))

    async def repeated(
        self, owner: str, data: bytes, boxes: list[list[float]], options: Options, key: str | None
    ) -> asyncio.Future[str] | None:
        """The session that :meth:`create` makes or has made with the same key and content; None if it is the first.

        Raises bad-request for a key that was used with others.
        """
        return await self._creations.repeated(owner, key, data, repr((boxes, options)))

    async def restore(self, owner: str, snapshot: bytes, key: str | None) -> Session:
        """A session that goes on from a snapshot's contents, under a new id; the same one for the same ``key``."""

        async def make() -> str:
            session = self._open(owner, Options("default", "reject", None, False, self._settings.idle_timeout_s))
            with self._undone_on_error(session):
                told = await session.resume(snapshot)
                idle_s = self._longest_idle(told["idle_timeout_s"])
                session.options = Options(told["preset"], told["on_resize"], told["label"], told["maps"], idle_s)
                self.store.save(session)
            return session.id

        return self.find(owner, await self._creations.once(owner, key, snapshot, "snapshot", make))

    def end(self, session: Session, reason: str) -> None:
        """End a session: ``closed``, ``idle``, ``expired`` or ``lost``."""
        self._end(session, reason)

    def close(self, owner: str, sid: str) -> None:
        """End the caller's session; nothing more if it has ended already. Raises session-not-found."""
        try:
            session = self.find(owner, sid)
        except ProblemError as gone:
            if gone.code != "session-gone":
                raise
        else:
            self._end(session, "closed")

    def expires_at(self, session: Session) -> datetime:
        """When the session ends if nothing more comes."""
        left = min(self._idle_deadline(session), session.created + self._settings.max_session_s) - self._clock()
        return datetime.now(UTC) + timedelta(seconds=max(0.0, left))

    async def load(self) -> None:
        """Take up the sessions that another process has left. Raises StateDirError."""
        await asyncio.to_thread(self.store.take_over)
        saved, damaged = self.store.load()
        for one in saved:
            options = options_of(one)
            options = replace(options, idle_timeout_s=self._longest_idle(options.idle_timeout_s))
            session = self._session(one.id, one.owner, options, created_at_of(one))
            self.store.restore_into(session, one)
            self._sessions[one.id] = session
            session.revive()
        for sid, owner in damaged:
            self._tombstones.put(owner, sid, Tombstone(owner, "lost", "what was saved of it is damaged"))
        if saved or damaged:
            whole = sum(one.whole for one in saved)
            log.info("sessions taken up", sessions=len(saved), whole=whole, damaged=len(damaged))

    def drain(self, reconnect_in_s: Callable[[], float]) -> None:
        """No new sessions from now on; every stream is told, and ends when sessions outlive the process."""
        self.draining = True
        for attachment in self._attachments():
            attachment.tell({"type": "draining", "reconnect_in_s": reconnect_in_s(), "resumable": self.store.durable})
            if self.store.durable:
                attachment.finish(1012, "service restart")

    async def save_all(self) -> None:
        """Write all sessions to the state directory."""
        await self.store.save_all(self._sessions.values())

    def streams(self) -> int:
        """Attached streams."""
        return len(self._attachments())

    def streams_of(self, owner: str) -> int:
        """Attached streams of one owner."""
        return sum(s.attachment is not None for s in self._sessions.values() if s.owner == owner)

    def end_streams(self, code: int, reason: str, which: Callable[[Attachment], bool] = lambda _: True) -> int:
        """Close streams, all or those chosen, and say how many; the sessions stay."""
        chosen = [attachment for attachment in self._attachments() if which(attachment)]
        for attachment in chosen:
            attachment.end(code, reason)
        return len(chosen)

    def sweep(self) -> None:
        """End what is overdue, close streams that nobody reads, forget what is old."""
        now = self._clock()
        for session in list(self._sessions.values()):
            if reason := self._overdue(session):
                self._end(session, reason)
            elif session.attachment is not None:
                session.attachment.check(now)
        self._tombstones.sweep()
        self._creations.sweep()

    async def run_sweeper(self) -> None:
        """Sweep, for as long as the service runs."""
        while True:
            await asyncio.sleep(SWEEP_EVERY_S)
            self.sweep()

    async def follow_lanes(self) -> None:
        """Restore the sessions of lanes that die, and move those of full ones, for as long as the service runs."""
        self._revive_lost()
        async for event in self._lanes.events():
            if isinstance(event, LaneCrowded):
                if event.key in self._sessions:
                    self._sessions[event.key].move(event.lane)
                continue
            if isinstance(event, KeysLost):
                self._metrics.lane_restarts.labels(cause=event.cause).inc()
                log.error("lane lost", lane=event.lane, cause=event.cause, sessions=len(event.keys))
            else:
                log.info("lane ready", lane=event.lane, confined=event.confined)
            self._revive_lost()

    def _revive_lost(self) -> None:
        """Restore the sessions that no lane has, those too that gave up waiting for one."""
        for session in self._sessions.values():
            if not session.lane.has_lane:
                session.revive()

    def _open(self, owner: str, options: Options) -> Session:
        """A place in a lane, taken at once or not at all, and a session around it."""
        if self.draining:
            raise self._unavailable("draining", self._settings.drain_grace_s)
        self._check_quota(owner)
        if self.store.budget.spent:
            raise self._unavailable("at-capacity", 1.0, "no memory for another session")
        sid = secrets.token_urlsafe(ID_BYTES)
        try:
            self._lanes.reserve(sid, owner)
        except AtCapacity:
            self.sweep()
            try:
                self._lanes.reserve(sid, owner)
            except AtCapacity:
                ready = any(lane.ready for lane in self._lanes.status())
                raise self._unavailable("at-capacity", 1.0, NO_PLACE if ready else NO_LANE) from None
        self._opening[owner] += 1
        return self._session(sid, owner, options, datetime.now(UTC))

    def _session(self, sid: str, owner: str, options: Options, created_at: datetime) -> Session:
        self._ordinal += 1
        return Session(
            sid,
            owner,
            options,
            self.store.lane_state(sid, owner),
            on_saveable=self.store.save,
            on_poison=lambda session, detail: self._end(session, "lost", detail),
            ordinal=self._ordinal,
            created=self._clock() - max(0.0, (datetime.now(UTC) - created_at).total_seconds()),
            created_at=created_at,
            max_trajectory_bytes=self._settings.max_trajectory_bytes,
            clock=self._clock,
            max_messages_per_s=self._settings.max_messages_per_s,
        )

    @contextlib.contextmanager
    def _undone_on_error(self, session: Session) -> Iterator[None]:
        try:
            yield
        except BaseException as failed:
            self._lanes.release(session.id)
            self.store.delete(session)
            if isinstance(failed, ProblemError) and failed.code == "session-gone":
                # Its lane died under it: for the client there never was a session.
                raise self._unavailable("at-capacity", 1.0, "its lane ended as the session began") from failed
            raise
        finally:
            self._opening -= Counter((session.owner,))
        session.touch()
        self._sessions[session.id] = session
        self._metrics.sessions_created.labels(preset=session.options.preset).inc()

    def _check_quota(self, owner: str) -> None:
        """Raises over-quota for a key with as many sessions as it may have, those included that begin."""
        most = self.shares.sessions
        if most >= self._settings.capacity:
            return  # there is no place beyond it anyway
        for expired_went in (False, True):
            if self._opening[owner] + sum(s.owner == owner for s in self._sessions.values()) < most:
                return
            if not expired_went:
                self.sweep()
        self._metrics.refused_sessions.labels(reason="over-quota").inc()
        raise ProblemError("over-quota", f"at most {most} sessions of a key", retry_after_s=1.0)

    def _unavailable(self, code: str, retry_after_s: float, detail: str = "") -> ProblemError:
        self._metrics.refused_sessions.labels(reason=code).inc()
        if code == "draining":
            detail = "the service is going away"
        return ProblemError(code, detail, retry_after_s=retry_after_s)

    def _idle_deadline(self, session: Session) -> float:
        if session.attachment is not None:
            return session.touched + self._settings.attached_idle_timeout_s
        return session.touched + session.options.idle_timeout_s

    def _overdue(self, session: Session) -> str:
        now = self._clock()
        if now > session.created + self._settings.max_session_s:
            return "expired"
        return "idle" if now > self._idle_deadline(session) and not session.busy else ""

    def _longest_idle(self, seconds: float) -> float:
        """The idle time that a session may have here, whatever another service or an earlier setting gave it."""
        return min(seconds, self._settings.max_idle_timeout_s)

    def _end(self, session: Session, reason: str, detail: str = "") -> None:
        session.ended = reason
        self._sessions.pop(session.id, None)
        self._lanes.release(session.id)
        self.store.delete(session)
        self._tombstones.put(session.owner, session.id, Tombstone(session.owner, reason, detail))
        self._metrics.sessions_closed.labels(reason=reason).inc()
        log.info("session ended", session=session.id, reason=reason, detail=detail, seq=session.seq)
        if session.attachment is not None:
            session.attachment.end(CLOSE_CODES[reason], f"session ended: {detail or reason}")

    def _attachments(self) -> list[Attachment]:
        return [s.attachment for s in self._sessions.values() if s.attachment is not None]
