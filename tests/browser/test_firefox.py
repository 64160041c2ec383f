"""The page in Firefox: the first visit, and a file whose every frame is tracked."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import pytest

from service.load.own import OwnServer
from tests.conftest import require

from .bidi import Firefox, firefox
from .conftest import loop
from .films import BOX, film, uneven

pytestmark = loop
FRAMES = "Number(document.getElementById('stage').dataset.frames)"
STATE = "document.documentElement.dataset.state"


async def violations(page: Firefox) -> list[str]:
    """What axe finds wrong with the page as it is now."""
    require(find_spec("axe_playwright_python"), "axe-playwright-python is not installed")
    from axe_playwright_python.base import AXE_SCRIPT

    await page.call("script.evaluate", expression=AXE_SCRIPT, target={"context": page.context}, awaitPromise=False)
    found = await page.evaluate("axe.run().then(({violations}) => violations.map(({id, help}) => `${id}: ${help}`))")
    return list(found)


async def drag(page: Firefox, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Drag the mouse between two points of the picture, in pixels of the source, once the picture lies still."""
    code = "(({x, y, width}) => [x, y, width / picture.width])(picture.getBoundingClientRect())"
    before, place = None, await page.evaluate(code)
    while place != before:
        before, place = place, await page.evaluate(f"new Promise((done) => setTimeout(done, 500)).then(() => {code})")
    left, top, scale = place
    points = [(left + x * scale, top + y * scale) for x, y in (start, end)]
    await page.drag(points[0], points[1])


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    return tmp_path / "profile"


async def test_the_first_visit_ends_with_a_tracked_balloon(server: OwnServer, profile: Path) -> None:
    async with firefox(profile) as page:
        await page.goto(server.url)
        assert await violations(page) == []
        await page.click("#choose-sample")
        await page.until(f"{STATE} === 'open'")
        await page.click("#follow-suggestion")
        await page.until(f"{FRAMES} >= 30")
        status = await page.evaluate("document.querySelector('#targets li').dataset.status")
        assert status in ("tracking", "uncertain")
        assert await violations(page) == []
        assert page.said == []


async def test_a_camera_is_tracked(server: OwnServer, profile: Path) -> None:
    """Firefox shows a camera of its own making."""
    async with firefox(profile) as page:
        await page.goto(server.url)
        await page.click("#choose-camera")
        await page.until(f"{STATE} === 'open'")
        await page.until("document.getElementById('picture').width > 100")
        await drag(page, (100, 100), (200, 200))
        await page.until(f"{FRAMES} >= 5")
        assert page.said == []


async def test_each_frame_of_a_file_is_tracked_once(server: OwnServer, profile: Path, tmp_path: Path) -> None:
    times = film(tmp_path / "uneven.webm", uneven(30), "libvpx")
    async with firefox(profile) as page:
        await page.goto(server.url)
        await page.choose_files("#file", tmp_path / "uneven.webm")
        await page.until(f"{STATE} === 'open'")
        place = "document.getElementById('picture').getBoundingClientRect()"
        left, top, scale = await page.evaluate(f"(({{x, y, width}}) => [x, y, width / 320])({place})")
        x, y, w, h = BOX
        await page.drag((left + x * scale, top + y * scale), (left + (x + w) * scale, top + (y + h) * scale))
        await page.until("document.getElementById('hint').innerText.includes('End of the video')")
        await page.evaluate(
            "(window.saved = new Promise((done) => { URL.createObjectURL = (blob) => done(blob.text()); }), 0)"
        )
        await page.click("#open-export")
        await page.click("#export [data-format=json]")
        frames = json.loads(await page.evaluate("window.saved"))["frames"]
    assert [frame["frame"] for frame in frames] == list(range(30))
    assert [frame["time_s"] for frame in frames] == pytest.approx(times, abs=1.5e-3)
