"""Turns of the event loop, beside work that takes all of every turn."""

from __future__ import annotations

import asyncio
import time

import pytest

from service import turns


class Flood:
    """Works for longer than a turn, and at once again, as connections do that pour."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.turns = 0
        self._loop = loop
        self._on = True

    def work(self) -> None:
        """Use the turn up, if there is any left, and come back."""
        if not turns.must_wait(self._loop):
            time.sleep(2 * turns.TURN_S)
        if self._on:
            self.turns += 1
            turns.later(self._loop, self.work)

    def end(self) -> None:
        """Come back no more."""
        self._on = False


@pytest.mark.parametrize("floods", [1, 5])
async def test_whoever_waits_is_let_through_before_those_who_came_later(floods: int) -> None:
    loop = asyncio.get_running_loop()
    pouring = [Flood(loop) for _ in range(floods)]
    for flood in pouring:
        flood.work()
    try:
        for _ in range(3):
            before = sum(flood.turns for flood in pouring)
            async with asyncio.timeout(10):
                await turns.give_way()
            assert sum(flood.turns for flood in pouring) - before <= 2 * floods + 2
    finally:
        for flood in pouring:
            flood.end()


async def test_floods_share_the_turns() -> None:
    loop = asyncio.get_running_loop()
    first, second = Flood(loop), Flood(loop)
    first.work()
    second.work()
    while first.turns < 20:
        await asyncio.sleep(0)
    first.end()
    second.end()
    assert second.turns >= first.turns - 1


async def test_those_who_stopped_waiting_hold_up_nobody() -> None:
    loop = asyncio.get_running_loop()
    flood = Flood(loop)
    flood.work()
    waiting = asyncio.ensure_future(turns.give_way())
    await asyncio.sleep(0)
    waiting.cancel()
    async with asyncio.timeout(10):
        await turns.give_way()
    flood.end()
