"""What a page does with the client beside tracking: it is left, it is refused, it shows boxes and has them drawn."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest

from service.client import AsyncClient
from service.load.clips import Clip
from service.load.own import OwnServer
from tests.chromium import FLAGS, chromium
from tests.service.live.conftest import Serve

from .browser import Pages
from .test_browser import STRICT, overlaps

Run = Callable[..., Awaitable[Any]]
POLICY = STRICT.replace("img-src", "style-src 'self'; img-src 'self'")


@pytest.fixture(scope="module")
def pages(clip: Clip) -> Iterator[Pages]:
    with Pages(clip.frames, POLICY) as served:
        yield served


@pytest.fixture(scope="module")
def service() -> Iterator[OwnServer]:
    with OwnServer(lanes=1, max_sessions_per_lane=64, allowed_origins="localhost", operation_deadline_s=60) as own:
        yield own


@asynccontextmanager
async def opened(pages: Pages, url: str, **launch: Any) -> AsyncIterator[tuple[Run, Any]]:
    path = chromium()
    playwright = pytest.importorskip("playwright.async_api")
    async with playwright.async_playwright() as driver:
        browser = await driver.chromium.launch(executable_path=path, args=FLAGS, **launch)
        try:
            page = await browser.new_page()
            errors: list[str] = []
            page.on("pageerror", lambda error: errors.append(str(error)))
            await page.goto(f"{pages.origin}/pages.html")

            async def run(name: str, clip: Clip, **given: Any) -> Any:
                await up(page)
                particulars = {"url": url, "frames": pages.frame_urls, "box": clip.box} | given
                return await page.evaluate("([name, given]) => window.run(name, given)", [name, particulars])

            yield run, page
            assert errors == []
        finally:
            await browser.close()


async def up(page: Any) -> None:
    while not await page.evaluate("window.up"):
        await asyncio.sleep(0.01)


async def left_over(server: OwnServer) -> set[str]:
    async with AsyncClient(server.url) as client:
        return {session.id async for session in client.sessions()}


async def test_reloads_leave_no_session_behind(pages: Pages, service: OwnServer, clip: Clip) -> None:
    async with opened(pages, service.url) as (run, page):
        made = set()
        for _ in range(5):
            made.add(await run("begun", clip))
            await page.reload()
        await up(page)
        for _ in range(1000):
            if not made & await left_over(service):
                break
            await asyncio.sleep(0.01)
        assert len(made) == 5
        assert not made & await left_over(service)


async def test_a_session_outlives_the_page_where_that_is_asked(pages: Pages, service: OwnServer, clip: Clip) -> None:
    async with opened(pages, service.url) as (run, page):
        kept = await run("begun", clip, create={"endWithPage": False})
        ended = await run("begun", clip)
        await page.reload()
        while ended in await left_over(service):
            await asyncio.sleep(0.01)
        assert kept in await left_over(service)


async def test_a_page_that_comes_back_is_told_that_its_session_ended(
    pages: Pages, service: OwnServer, clip: Clip
) -> None:
    """A page in the back-forward cache hears nothing, and may never come back: its place is given up when it goes."""
    async with opened(pages, service.url, ignore_default_args=["--disable-back-forward-cache"]) as (run, page):
        session = await run("begun", clip)
        await page.evaluate("addEventListener('pageshow', ({ persisted }) => (window.persisted = persisted))")
        await page.goto(f"{pages.origin}/harness.html")
        while session in await left_over(service):
            await asyncio.sleep(0.01)
        await page.go_back()
        await up(page)
        if await page.evaluate("window.persisted === true"):  # some browsers keep no page with an open WebSocket
            while not (ended := await page.evaluate("window.ended ?? null")):
                await asyncio.sleep(0.01)
            assert (ended["code"], ended["reason"]) == ("session-gone", "closed")


async def test_a_page_of_another_origin_is_told_what_to_set(own_server: Serve, pages: Pages, clip: Clip) -> None:
    """Browsers hide the refusal; the client finds out, without trying again and again."""
    server = own_server()
    async with opened(pages, server.url) as (run, page):
        posts: list[str] = []
        page.on("request", lambda request: request.method == "POST" and posts.append(request.url))
        refused = await run("refused", clip)
        away = await run("refused", clip, url="http://127.0.0.1:9")
    assert (refused["code"], refused["status"]) == ("origin-refused", 403)
    assert f"pages of {pages.origin}: add this origin to MFCMT_ALLOWED_ORIGINS" in refused["detail"]
    assert len([url for url in posts if url.startswith(server.url)]) == 1
    assert (away["code"], away["status"]) == ("connection-lost", 0)
    assert "MFCMT_ALLOWED_ORIGINS" in away["detail"]


async def test_a_full_service_says_when_a_place_is_free(own_server: Serve, pages: Pages, clip: Clip) -> None:
    """A session that nobody uses any more tells when it ends."""
    server = own_server(max_sessions_per_lane=1, idle_timeout_s=120, allowed_origins="localhost")
    async with opened(pages, server.url) as (run, _), AsyncClient(server.url) as client:
        await client.create(clip.frames[0], box=clip.box)
        refused = await run("refused", clip)
    assert refused["code"] == "at-capacity"
    assert 60 < refused["retryAfter"] <= 120
    assert f"ends in {refused['retryAfter']:.0f} s" in refused["detail"]


@pytest.mark.parametrize("regions", [False, True])
async def test_boxes_are_in_pixels_of_the_source_where_that_is_asked(
    pages: Pages, service: OwnServer, clip: Clip, regions: bool
) -> None:
    """Whatever `maxSide` made of it: what is given, what is told, over HTTP and in a stream."""
    async with opened(pages, service.url) as (run, _):
        told = await run("source", clip, maxSide=240, regions=regions)
    size = list(clip.size)
    assert told["sent"][0] == told["sent"][1]
    assert max(told["sent"][0]) == 240
    assert told["info"] == [size, pytest.approx(clip.box)]
    assert told["http"][0] == told["size"] == told["stream"][0] == told["past"] == size
    assert told["corrected"] == pytest.approx(clip.box)
    assert told["added"] == pytest.approx(clip.box)
    assert told["stream"][1] == told["boxes"][len(clip.frames) - 2]
    assert np.mean(overlaps(told["boxes"][: len(clip.frames) - 1], clip)) > 0.7


@pytest.mark.parametrize(
    ("fit", "position"), [("contain", ""), ("contain", "0% 0%"), ("cover", ""), ("fill", ""), ("none", "10px 100%")]
)
async def test_boxes_are_shown_and_drawn_where_the_picture_is(
    pages: Pages, service: OwnServer, clip: Clip, fit: str, position: str
) -> None:
    """A picture in an element of another shape, with border and padding."""
    width, height = clip.size
    inner, edge = 400, 5 + 3
    scale = {"contain": min, "cover": max}.get(fit)
    x_scale, y_scale = inner / width, inner / height
    if scale is not None:
        x_scale = y_scale = scale(x_scale, y_scale)
    elif fit == "none":
        x_scale = y_scale = 1.0
    room = inner - width * x_scale, inner - height * y_scale
    left, top = {"": (room[0] / 2, room[1] / 2), "0% 0%": (0, 0), "10px 100%": (10, room[1])}[position]
    x, y, w, h = clip.box
    expected = [edge + left + x * x_scale, edge + top + y * y_scale, w * x_scale, h * y_scale]
    async with opened(pages, service.url) as (run, page):
        told = await run("shown", clip, fit=fit, position=position)
        assert told["area"] == pytest.approx([left, top, width * x_scale, height * y_scale], abs=0.01)
        assert told["rectangle"] == pytest.approx(expected, abs=0.01)
        assert told["label"] == "target 7"
        corner = told["corner"]
        await page.mouse.move(corner[0] + expected[0] + expected[2], corner[1] + expected[1])
        await page.mouse.down()
        await page.mouse.move(corner[0] + expected[0] + 9, corner[1] + expected[1] + 9)
        await page.mouse.move(corner[0] + expected[0], corner[1] + expected[1] + expected[3])
        await page.mouse.up()
        drawn = await page.evaluate("window.drawn")
        assert drawn == pytest.approx(clip.box, abs=1.01 / min(x_scale, y_scale))
        assert await page.evaluate("window.drafts") >= 2
        await page.evaluate("window.drawn = null; window.stopDrawing(); window.layer.remove()")
        await page.mouse.down()
        await page.mouse.move(corner[0] + 200, corner[1] + 200)
        await page.mouse.up()
        assert await page.evaluate("window.drawn") is None
        assert await page.locator("svg").count() == 0
