"""By keys alone, on a phone, in light and dark, and what axe finds."""

from __future__ import annotations

import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from service.load.own import OwnServer
from tests.conftest import require

from .conftest import Open, loop
from .driver import Tracker

pytestmark = loop
PHONE = {
    "viewport": {"width": 390, "height": 844},
    "device_scale_factor": 2,
    "is_mobile": True,
    "has_touch": True,
    "user_agent": "Mozilla/5.0 (Linux; Android 16; Pixel 9) AppleWebKit/537.36 Chrome/156.0.0.0 Mobile Safari/537.36",
}
FINGER_PX = 36
DEMO = "import sys; from mfcmt_core.cli import main; sys.exit(main(['demo', '--no-browser']))"


async def violations(user: Tracker) -> list[str]:
    """What axe finds wrong with the page as it is now."""
    require(find_spec("axe_playwright_python"), "axe-playwright-python is not installed")
    from axe_playwright_python.async_playwright import Axe

    found = await Axe().run(user.page)
    return [f"{v['id']}: {v['help']} {[n['target'] for n in v['nodes']]}" for v in found.response["violations"]]


async def test_the_page_works_with_the_keyboard_alone(open_page: Open) -> None:
    async with open_page() as user:
        keys = user.page.keyboard

        async def to(id_: str) -> None:
            for _ in range(40):
                if await user.page.evaluate("document.activeElement.id") == id_:
                    return
                await keys.press("Tab")
            pytest.fail(f"no way to {id_} by Tab")

        await to("choose-sample")
        await keys.press("Enter")
        await user.until("document.documentElement.dataset.state === 'open'")
        await to("stage")
        await keys.press("Enter")
        assert "Arrows move" in await user.page.inner_text("#hint")
        await keys.press("Alt+ArrowRight")
        await keys.press("Escape")
        assert await user.page.evaluate("document.documentElement.dataset.state") == "open"
        await keys.press("Enter")
        await keys.press("ArrowLeft")
        await keys.press("ArrowRight")
        await keys.press("Shift+ArrowDown")
        await keys.press("Shift+ArrowUp")
        await keys.press("Enter")
        await user.frames(10)
        first = (await user.boxes())["frames"][0]["targets"][0]["box"]
        assert first == pytest.approx((278, 184, 84, 112), abs=0.1)
        await to("stage")
        await keys.press("Space")
        await user.until("document.getElementById('play').getAttribute('aria-label') === 'Play'")
        count = await user.frames()
        await keys.press(".")
        await user.until(f"document.getElementById('stage').dataset.frames >= {count + 1}")
        await keys.press("a")
        await keys.press("Enter")
        for _ in range(6):
            await keys.press("ArrowRight")
        await keys.press("Enter")
        await user.until("document.querySelectorAll('#targets li').length === 2")
        await keys.press("2")
        await keys.press("Delete")
        await user.until("document.querySelectorAll('#targets li').length === 1")
        await keys.press("Space")
        await user.frames(5)


async def test_the_page_works_on_a_phone(open_page: Open, artefacts: Path) -> None:
    """Touch draws the box; regions are sent; nothing is wider than the screen; controls fit a finger."""
    async with open_page(color_scheme="dark", **PHONE) as user:
        await user.page.screenshot(path=artefacts / "phone-empty.png")
        await user.choose("sample")
        left, top, right, bottom = await user.corners((278 * 0.75, 184 * 0.75, 84 * 0.75, 112 * 0.75))
        touch = await user.page.context.new_cdp_session(user.page)

        async def finger(kind: str, *points: tuple[float, float]) -> None:
            touches = [{"x": x, "y": y} for x, y in points]
            await touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})

        await finger("touchStart", (left, top))
        await finger("touchMove", ((left + right) / 2, (top + bottom) / 2))
        await finger("touchMove", (right, bottom))
        await finger("touchEnd")
        await user.frames(40)
        assert await user.status() in ("tracking", "uncertain")
        await user.until("document.getElementById('stat-saved').innerText.includes('%')")
        assert await user.page.evaluate("document.documentElement.scrollWidth") <= 390
        buttons = await user.page.locator(".transport button:visible, .bar :is(button, a):visible").all()
        sizes = [box for button in buttons if (box := await button.bounding_box())]
        assert len(sizes) > 5
        assert all(min(box["width"], box["height"]) >= FINGER_PX for box in sizes), sizes
        await user.page.screenshot(path=artefacts / "phone.png")
        assert await violations(user) == []
        await user.page.click("#open-settings")
        await user.page.screenshot(path=artefacts / "phone-settings.png")


@pytest.mark.parametrize("scheme", ["light", "dark"])
async def test_axe_finds_no_fault(open_page: Open, artefacts: Path, scheme: str) -> None:
    async with open_page(color_scheme=scheme) as user:
        assert await violations(user) == []
        await user.page.screenshot(path=artefacts / f"empty-{scheme}.png")
        await user.choose("sample")
        assert await violations(user) == []
        await user.page.click("#follow-suggestion")
        await user.frames(120 if scheme == "light" else 20)
        await user.page.screenshot(path=artefacts / f"page-{scheme}.png")
        await user.page.click("#play")
        assert await violations(user) == []
        await user.page.click("#open-settings")
        await user.page.screenshot(path=artefacts / f"settings-{scheme}.png")
        assert await violations(user) == []
        await user.page.keyboard.press("Escape")
        await user.page.click("#open-export")
        assert await violations(user) == []
        await user.page.keyboard.press("Escape")
        await user.page.click("#open-keys")
        await user.page.screenshot(path=artefacts / f"keys-{scheme}.png")
        assert await violations(user) == []


async def test_the_page_can_be_installed(open_page: Open) -> None:
    """Chromium finds nothing missing in manifest and icons."""
    async with open_page() as user:
        session = await user.page.context.new_cdp_session(user.page)
        manifest: dict[str, Any] = await session.send("Page.getAppManifest")
        assert manifest["url"].endswith("/manifest.webmanifest")
        assert manifest["errors"] == []
        missing = (await session.send("Page.getInstallabilityErrors"))["installabilityErrors"]
        # a private window, as tests have, cannot install anything
        assert [error["errorId"] for error in missing if error["errorId"] != "in-incognito"] == []


async def test_the_demo_runs_by_itself(open_page: Open, server: OwnServer) -> None:
    """``mfcmt demo``: from the command to a moving box without a click."""
    process = subprocess.Popen([sys.executable, "-c", DEMO], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout
        address = next(word for word in process.stdout.readline().split() if word.startswith("http"))
        async with open_page(address) as user:
            await user.frames(30)
            assert await user.status() in ("tracking", "uncertain")
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
