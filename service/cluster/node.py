"""This node among others: finds sessions, takes up those of dead nodes, and hands over its own."""

from __future__ import annotations

import asyncio
import os
import random
import signal
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass

import structlog

from ..lanes.interface import Lanes
from ..protocol.enums import EndReason, ProblemCode
from ..protocol.problems import ProblemError, elsewhere, session_gone
from ..sessions.database import SavedSession, StateError
from ..sessions.registry import SessionRegistry
from ..sessions.session import Session
from ..sessions.ttl_cache import TTLCache
from ..settings import Settings
from . import scripts
from .asking import Asking, StoreAway
from .creations import Creation, Creations
from .membership import BEAT_EVERY_S, Load, Membership, NodeReplaced
from .redis_store import Node, RedisStore, key, new_epoch, now_ms
from .tickets import SharedTickets

KEEP_EVERY_BEATS = 15
# A place of a session that starts is kept for it for this long.
START_MS = 60_000
LOOKS = 3
# The answer to a creation waits no longer than this until the store has the session.
ANNOUNCE_S = 1.0
PLACES, PLACE_S = 10_000, 1.0
SESSIONS = "/v1/sessions"

log: structlog.stdlib.BoundLogger = structlog.get_logger("mfcmt.cluster")


@dataclass(frozen=True, slots=True)
class Place:
    """The node that has a session, and the session's owner."""

    owner: str
    node: Node


class ClusterNode:
    """The way from this node to the store and to the other nodes; see :class:`~service.sessions.interface.SharedNode`.

    ``registry`` is set before the node starts.
    """

    registry: SessionRegistry

    def __init__(self, settings: Settings, database: RedisStore, lanes: Lanes) -> None:
        self.database, self.me = database, database.node
        self._settings, self._lanes = settings, lanes
        self._membership = Membership(database)
        self._admit = database.client.register_script(scripts.ADMIT)
        self._ask = Asking()
        self.tickets = SharedTickets(database.client, self._ask)
        self._creations = Creations(database.client, self._ask, self.me.holder, settings.idempotency_s)
        self._taking: dict[str, asyncio.Task[None]] = {}
        self._leaving: dict[str, asyncio.Task[None]] = {}
        # Where sessions were found of late, so that Redis is not asked for every call.
        self._places: TTLCache[Place] = TTLCache(PLACES, PLACE_S, time.monotonic)
        self._beats = 0

    @property
    def leaving(self) -> int:
        """The number of sessions that are being handed over."""
        return sum(not task.done() for task in self._leaving.values())

    async def start(self) -> None:
        """Take the lease. Raises StateError."""
        loop = asyncio.get_running_loop()

        def on_late(sids: list[str]) -> None:
            loop.call_soon_threadsafe(self._let_go, sids)

        self.database.on_late = on_late
        try:
            await self._ask(self._membership.renew, self._load())
        except StoreAway as away:
            raise StateError(f"MFCMT_STORE: {away}") from away

    async def run(self) -> None:
        """Renew the lease for as long as the service runs."""
        while True:
            await asyncio.sleep(BEAT_EVERY_S)
            try:
                await self._renew()
            except StoreAway:
                pass  # told when it was noticed
            except NodeReplaced as replaced:
                log.error("this node stops", reason=str(replaced))
                os.kill(os.getpid(), signal.SIGTERM)
                return

    async def stop(self) -> None:
        """Give up the lease."""
        try:
            await self._ask(self._membership.leave)
        except StoreAway:
            log.warning("the lease could not be given up; it runs out by itself")
        self._ask.close()

    async def locate(self, owner: str, sid: str, rest: str = "", *, websocket: bool = False) -> None:
        """Make sure that a session is here, if it is anywhere.

        A session that no living node has is taken up. ``rest`` is what follows the session in the URL of the call, and
        ``websocket`` whether it is a handshake.

        Raises
        ------
        ProblemError
            elsewhere if another node has it; session-gone; at-capacity if the store does not answer.
        """
        for _ in range(LOOKS):
            if (task := self._leaving.get(sid)) is not None:
                await asyncio.wait([task])
            if await self._is_here(sid):
                return
            if (place := self._places.get(sid)) is not None and place.owner == owner:
                raise self._elsewhere(place.node, sid, rest, websocket)
            try:
                found = await self._ask(self.database.whereabouts, sid)
            except StoreAway as away:
                raise _unknown_now(str(away)) from away
            if found is None or found.owner != owner:
                return
            if found.ended is not None:
                raise session_gone(found.ended.reason, found.ended.detail)
            if found.node is not None and found.node.holder != self.me.holder:
                self._places.put(owner, sid, Place(owner, found.node))
                raise self._elsewhere(found.node, sid, rest, websocket)
            if self.registry.draining or not self._has_room():
                peer = self._peer()
                if peer is None:
                    code = ProblemCode.DRAINING if self.registry.draining else ProblemCode.AT_CAPACITY
                    raise ProblemError(code, "no node has a place to take the session up", retry_after_s=1.0)
                raise self._elsewhere(peer, sid, rest, websocket)
            await self._take_up(owner, sid)
        raise _unknown_now("nodes change")

    def forget_place(self, url: str) -> None:
        """Ask Redis again for the session in the URL of a call, because its node did not answer."""
        self._places.pop(url.partition(f"{SESSIONS}/")[2].partition("/")[0].partition("?")[0])

    async def admit(self, owner: str, sid: str) -> int:
        """Count a new session among those that the owner has at all nodes, and return the epoch of its first claim.

        Raises over-quota, elsewhere while this node drains, and at-capacity if the store has been away for too long.
        """
        if self.registry.draining and (peer := self._peer()) is not None:
            raise elsewhere(peer.name, peer.url + SESSIONS)
        most, now = self._settings.max_sessions_per_key, now_ms()
        try:
            if most is not None and not await self._ask(
                self._admit, keys=[key("owner", owner)], args=[now, now + START_MS, sid, most]
            ):
                raise ProblemError(ProblemCode.OVER_QUOTA, f"at most {most} sessions of a key", retry_after_s=1.0)
        except StoreAway:
            pass  # this node keeps its own limits
        if (away_s := self._ask.away_s) > self._settings.store_grace_s:
            detail = f"the store has been away for {away_s:.0f} s: no new session could outlive this node"
            raise ProblemError(ProblemCode.AT_CAPACITY, detail, retry_after_s=BEAT_EVERY_S)
        return new_epoch()

    async def announce(self, sid: str) -> None:
        """Wait until the other nodes can find a new session, if the store answers."""
        if not self._ask.is_away:
            await asyncio.to_thread(self.database.flush, ANNOUNCE_S, sid)

    async def once(
        self, owner: str, name: str, data: bytes | memoryview, rest: str, make: Callable[[], Awaitable[str]]
    ) -> str:
        """Return the id of what ``make`` makes, unless a call with this Idempotency-Key came to any node before.

        Raises bad-request if it came with other content, elsewhere if another node has what it made.
        """
        return await self._creations.once(owner, name, data, rest, make, self._follow)

    async def _follow(self, owner: str, known: Creation) -> str | None:
        """Return the id that another call made, once it is here; None if the node that worked at it is gone."""
        if not known.sid:
            maker = next((node for node in self._membership.peers if node.holder == known.holder), None)
            if maker is None:
                return None
            raise elsewhere(maker.name, maker.url + SESSIONS)
        try:
            await self.locate(owner, known.sid)
        except ProblemError as refused:
            if refused.code is not ProblemCode.ELSEWHERE:
                raise
            url = str(refused.members["url"]).removesuffix(f"/{known.sid}")
            raise elsewhere(refused.detail.partition(" ")[0], url) from None
        return known.sid

    def place_for(self, sid: str) -> str | None:
        """Return the URL of a session's stream at a node that can take it up; None if no other node is there."""
        peer = self._peer()
        return None if peer is None else f"{_as_websocket(peer.url)}{SESSIONS}/{sid}/stream"

    def another(self) -> ProblemError | None:
        """Return the refusal that sends a creation to a node with a place; None if there is none."""
        peer = self._peer()
        return None if peer is None else elsewhere(peer.name, peer.url + SESSIONS)

    def streams_elsewhere(self, owner: str) -> int:
        """Return the number of streams that the owner has at other nodes, as they said of late."""
        return sum(load.streams.get(owner, 0) for load in self._membership.peers.values())

    def hand_over(self, session: Session) -> None:
        """Begin to save a session whole and give it up; then its stream is closed."""
        if session.id not in self._leaving:
            self._leaving[session.id] = asyncio.get_running_loop().create_task(self._hand_over(session))

    async def _hand_over(self, session: Session) -> None:
        if session.ended:
            return
        if await self.registry.store.save_whole(session):
            self.database.drop(session.id)
            with suppress(StoreAway):
                await self._ask(self.database.release, session.id, session.epoch)
        else:
            log.error("session could not be saved whole", session=session.id)
        self.registry.let_go(session, "node restart")

    async def _is_here(self, sid: str) -> bool:
        """Return whether this node has a session; lets go of it if another one has claimed it meanwhile."""
        session = self.registry.here(sid)
        if session is None:
            return False
        if self._membership.holds or self._ask.is_away:
            return True
        # The lease has run out, because this process stood still: nothing was told to it.
        try:
            late, _ = await self._ask(self.database.late, {sid: session.epoch})
        except StoreAway:
            return True
        self._let_go(late)
        return not late

    async def _take_up(self, owner: str, sid: str) -> None:
        """Claim a session and go on with it, once however many ask at the same time."""
        task = self._taking.get(sid)
        if task is None:
            task = self._taking[sid] = asyncio.get_running_loop().create_task(self._claim(owner, sid))
            task.add_done_callback(lambda _: self._taking.pop(sid, None))
        await asyncio.shield(task)

    async def _claim(self, owner: str, sid: str) -> None:
        try:
            saved: SavedSession | None = await self._ask(self.database.claim, sid)
        except StoreAway as away:
            raise _unknown_now(str(away)) from away
        except StateError as damaged:
            self.registry.bury(owner, sid, EndReason.LOST, str(damaged))
            return
        if saved is not None:
            self._leaving.pop(sid, None)
            self.registry.take_up(saved)
            log.info("session taken up", session=sid, whole=saved.whole, seq=saved.front["seq"])

    async def _renew(self) -> None:
        if await self._ask(self._membership.renew, self._load()):
            await self._reconcile()
        self._places.sweep()
        self._beats += 1
        if self._beats % KEEP_EVERY_BEATS == 0:
            store = self.registry.store
            living = {sid: store.keep_s(session) for sid, session in self.registry.living().items()}
            await self._ask(self.database.keep, living)

    async def _reconcile(self) -> None:
        """Let go of what others have claimed, and save again what Redis does not know."""
        sessions = self.registry.living()
        late, unknown = await self._ask(self.database.late, {sid: one.epoch for sid, one in sessions.items()})
        self._let_go(late)
        for sid in sessions.keys() - set(late):
            sessions[sid].saved_to = -1  # the next time with its whole past, in case Redis has an older one
        for sid in unknown:
            self.registry.store.save(sessions[sid])
        if late or unknown:
            log.warning("the store was without this node", claimed_by_others=len(late), saved_again=len(unknown))

    def _let_go(self, sids: list[str]) -> None:
        for sid in sids:
            self.database.drop(sid)
            if (session := self.registry.here(sid)) is not None:
                self.registry.let_go(session, "another node has taken the session up")

    def _peer(self) -> Node | None:
        """Return another node that takes sessions, by chance in proportion to its free places."""
        free = {node: load.free for node, load in self._membership.peers.items() if load.open and load.free > 0}
        return random.choices(list(free), list(free.values()))[0] if free else None  # noqa: S311

    def _elsewhere(self, node: Node, sid: str, rest: str, websocket: bool) -> ProblemError:
        url = _as_websocket(node.url) if websocket else node.url
        return elsewhere(node.name, f"{url}{SESSIONS}/{sid}{rest}")

    def _has_room(self) -> bool:
        return self._free() > 0

    def _free(self) -> int:
        """Return the number of free places in lanes that are ready."""
        most = self._settings.max_sessions_per_lane
        return sum(max(0, most - lane.keys) for lane in self._lanes.status() if lane.ready)

    def _load(self) -> Load:
        sessions = self.registry.living().values()
        streams = Counter(one.owner for one in sessions if one.attachment is not None)
        return Load(self._free(), not self.registry.draining, streams)


def _as_websocket(url: str) -> str:
    return f"ws{url.removeprefix('http')}"


def _unknown_now(why: str) -> ProblemError:
    detail = f"it cannot be told now which node has the session: {why}"
    return ProblemError(ProblemCode.AT_CAPACITY, detail, retry_after_s=1.0)
