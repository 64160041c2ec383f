"""A server that is silent, a network that is away, a tab that is hidden: a file waits, and loses no frame."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest

from service.load.own import OwnServer

from .conftest import Open, loop
from .driver import Tracker
from .films import BOX, even, film

pytestmark = loop
FRAMES = 240


@contextmanager
def silent(server: OwnServer) -> Iterator[None]:
    """The server holds its connections and answers nothing."""
    os.kill(server.pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(server.pid, signal.SIGCONT)


async def begun(user: Tracker, folder: Path, mode: str) -> None:
    film(folder / "film.mp4", even(FRAMES, 30))
    await user.set("mode", mode)
    await user.open_file(folder / "film.mp4")
    await user.draw(BOX)
    await user.frames(10)


@pytest.mark.parametrize("mode", ["lossless", "latest"])
async def test_a_file_waits_for_a_silent_server_and_the_page_says_so(
    open_page: Open, own_server: Callable[..., OwnServer], tmp_path: Path, mode: str
) -> None:
    server = own_server()
    async with open_page(server.url) as user:
        await begun(user, tmp_path, mode)
        with silent(server):
            await user.until("document.getElementById('connection-text').innerText.startsWith('No answer for ')")
            assert await user.page.get_attribute("#connection", "data-tone") == "busy"
            assert await user.page.get_attribute("#stage", "data-stale") is not None
            stands = await user.page.inner_text("#clock")
            await asyncio.sleep(1)
            assert await user.page.inner_text("#clock") == stands
        await user.until("document.getElementById('connection-text').innerText === 'Tracking'")
        await user.frames(10)
        await user.pause()
        numbers = [frame["frame"] for frame in (await user.boxes())["frames"]]
        gaps = [after - before for before, after in pairwise(numbers)]
        assert max(gaps) < 15, gaps  # what plays in the time without which nobody can know that an answer is late
        if mode == "lossless":
            assert numbers == list(range(len(numbers)))


async def test_a_file_waits_while_the_tab_is_hidden(open_page: Open, tmp_path: Path) -> None:
    async with open_page() as user:
        await begun(user, tmp_path, "latest")
        await user.page.evaluate(
            "Object.defineProperty(document, 'hidden', {get: () => true, configurable: true});"
            "document.dispatchEvent(new Event('visibilitychange'))"
        )
        await asyncio.sleep(0.5)
        before = await user.frames()
        await asyncio.sleep(1)
        assert await user.frames() == before
        await user.page.evaluate("delete document.hidden; document.dispatchEvent(new Event('visibilitychange'))")
        await user.frames(5)
