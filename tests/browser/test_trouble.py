"""What breaks and what is refused: the page says what happened and what to do."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import httpx2

from service.client import AsyncClient
from service.load.clips import Clip
from service.load.own import OwnServer

from .conftest import Open, launched, loop
from .tap import Tap

pytestmark = loop
KEY = "a-key-that-is-long-enough"
STARTED = "document.documentElement.dataset.state === 'tracking'"


async def test_a_lost_connection_is_restored(open_page: Open, server: OwnServer) -> None:
    async with Tap(server.port) as tap, open_page(tap.url) as user:
        user.expected.append("WebSocket connection")
        await user.follow_sample(10)
        tap.cut()
        await user.until("document.getElementById('log').innerText.includes('tracking goes on')")
        assert "lost; trying again" in await user.log()
        await user.frames(20)
        assert await user.notice() == ""
        assert await user.page.inner_text("#connection-text") == "Tracking"
        assert await user.status() in ("tracking", "uncertain")
        ends = [one for one in tap.streams() if any(m["type"] == "result" for m in one[1])]
        sessions = {next(m for m in heard if m["type"] == "ready")["session"]["id"] for _, heard in ends}
        assert len(ends) == 2
        assert len(sessions) == 1
        frames = (await user.boxes())["frames"]
        assert [f["frame"] for f in frames] == sorted({f["frame"] for f in frames})


async def test_the_page_says_that_the_server_is_away(open_page: Open, own_server: Callable[..., OwnServer]) -> None:
    server = own_server(drain_grace_s=0)
    async with open_page(server.url) as user:
        user.expected += ["WebSocket connection", "ERR_CONNECTION_REFUSED", "Failed to load resource"]
        await user.follow_sample(5)
        server.stop()
        await user.until("document.getElementById('notice').innerText.includes('Reconnecting')")
        assert await user.page.get_attribute("#connection", "data-tone") == "busy"
        await user.until("document.getElementById('stage').hasAttribute('data-stale')")
        server.start()  # it has forgotten the session, but the page has the frame and the boxes
        await user.until("document.getElementById('log').innerText.includes('a new one goes on')", patience_s=120)
        await user.until(STARTED)
        await user.frames(5)
        numbers = [frame["frame"] for frame in (await user.boxes())["frames"]]
        assert numbers == list(range(len(numbers)))  # and it went on with the frame that was tracked last


async def test_a_refused_camera_is_explained(open_page: Open) -> None:
    async with launched(["--use-fake-device-for-media-stream"]) as browser, open_page(browser=browser) as user:
        await user.page.click("#choose-camera")
        await user.until("!document.getElementById('notice').hidden")
        assert "Camera access was refused" in await user.notice()
        assert await user.page.inner_text("#notice-action") == "Try again"
        assert await user.page.is_visible("#welcome")


async def test_a_missing_camera_is_explained(open_page: Open) -> None:
    async with launched(["--use-fake-ui-for-media-stream"]) as browser, open_page(browser=browser) as user:
        await user.page.click("#choose-camera")
        await user.until("!document.getElementById('notice').hidden")
        assert "No camera was found" in await user.notice()


async def test_a_full_server_is_explained(open_page: Open, own_server: Callable[..., OwnServer], clip: Clip) -> None:
    server = own_server(max_sessions_per_lane=1)
    async with AsyncClient(server.url) as client:
        other = await client.create(clip.frames[0], clip.box)
        async with open_page(server.url) as user:
            user.expected.append("503")
            await user.choose("sample")
            await user.page.click("#follow-suggestion")
            await user.until("!document.getElementById('notice').hidden")
            assert "The server is full" in await user.notice()
            await other.close()
            await user.page.click("#notice-action")
            await user.until(STARTED)
            await user.frames(3)


async def test_a_key_is_asked_for(open_page: Open, own_server: Callable[..., OwnServer]) -> None:
    server = own_server(api_keys=KEY)
    async with open_page(server.url) as user:
        user.expected.append("401")
        await user.choose("sample")
        await user.page.click("#follow-suggestion")
        await user.page.fill("#key", "a-wrong-key-long-enough")
        await user.page.keyboard.press("Enter")
        await user.until("document.getElementById('key-text').innerText.includes('not valid')")
        await user.page.fill("#key", KEY)
        await user.page.keyboard.press("Enter")
        await user.until(STARTED)
        await user.frames(5)
        assert not any(KEY in url for url in user.asked)


async def test_an_expired_session_goes_on_with_one_click(open_page: Open, own_server: Callable[..., OwnServer]) -> None:
    server = own_server(attached_idle_timeout_s=1)
    async with open_page(server.url) as user:
        await user.follow_sample(5)
        await user.page.keyboard.press("Space")
        await user.until("document.documentElement.dataset.state === 'ended'")
        assert "The session expired No frame came for too long" in await user.notice()
        assert "Ended" in await user.log()
        before = await user.frames()
        await user.page.click("#notice-action")
        await user.until(STARTED)
        assert await user.frames(5) > before  # the export goes on where it was


async def test_one_target_too_many_is_explained(open_page: Open, own_server: Callable[..., OwnServer]) -> None:
    server = own_server(max_targets_per_session=1)
    async with open_page(server.url) as user:
        await user.follow_sample(5)
        await user.draw((500, 100, 60, 60))
        await user.until("!document.getElementById('notice').hidden")
        assert "No room for another target" in await user.notice()
        await user.frames(5)  # and the first is followed all the same
        assert await user.status(1) in ("tracking", "uncertain")


async def test_a_closed_page_releases_its_place(open_page: Open, own_server: Callable[..., OwnServer]) -> None:
    server = own_server()
    async with open_page(server.url) as user:
        await user.follow_sample(3)
        async with httpx2.AsyncClient(base_url=server.url) as http:
            assert len((await http.get("/v1/sessions")).json()["sessions"]) == 1
            await user.leave()
            for _ in range(100):
                if not (await http.get("/v1/sessions")).json()["sessions"]:
                    break
                await asyncio.sleep(0.05)
            assert (await http.get("/v1/sessions")).json()["sessions"] == []
