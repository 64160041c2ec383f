"""The page in a real browser: Chromium, a camera that shows a real sequence, the service behind it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from service.load.own import OwnServer
from tests.chromium import FLAGS, chromium
from tests.conftest import OTB_ROOT, ROOT, require
from tests.service.conftest import clip, own_server, server

from .driver import Tracker

ARTEFACTS = ROOT / "results" / "browser"
CAMERA = "David"
CAMERA_FRAMES = 460
__all__ = ["clip", "own_server", "server"]  # fixtures
Open = Callable[..., AbstractAsyncContextManager[Tracker]]
loop = pytest.mark.asyncio(loop_scope="package")


@pytest.fixture(scope="package")
def camera_frames() -> list[bytes]:
    """What the camera shows, as JPEG images."""
    folder = OTB_ROOT / CAMERA / "img"
    require(folder.is_dir(), f"no sequence {CAMERA} at {OTB_ROOT} (set MFCMT_OTB_ROOT)")
    return [file.read_bytes() for file in sorted(folder.glob("*.jpg"))[:CAMERA_FRAMES]]


@pytest_asyncio.fixture(scope="package", loop_scope="package")
async def chrome(camera_frames: list[bytes], tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Any]:
    """A browser with a camera that it may use."""
    film = tmp_path_factory.mktemp("camera") / "camera.mjpeg"
    film.write_bytes(b"".join(camera_frames))
    camera = ["--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream"]
    async with launched([*camera, f"--use-file-for-fake-video-capture={film}"]) as browser:
        yield browser


@asynccontextmanager
async def launched(flags: list[str]) -> AsyncIterator[Any]:
    """A browser with these flags besides the usual ones."""
    path = chromium()
    from playwright.async_api import async_playwright

    async with async_playwright() as driver:
        browser = await driver.chromium.launch(executable_path=path, args=[*FLAGS, "--hide-scrollbars", *flags])
        yield browser
        await browser.close()


@pytest_asyncio.fixture(loop_scope="package")
async def open_page(chrome: Any, server: OwnServer) -> Open:
    """Opens the page of the shared server (or of ``url``); at the end the console must be clean."""

    @asynccontextmanager
    async def opened(url: str = server.url, *, browser: Any = chrome, **context: Any) -> AsyncIterator[Tracker]:
        context = {"viewport": {"width": 1280, "height": 800}, "accept_downloads": True} | context
        async with await browser.new_context(**context) as of:
            page = await of.new_page()
            tracker = Tracker(page, url)
            await page.goto(url)
            yield tracker
            await tracker.leave()
        tracker.check()

    return opened


@pytest.fixture(scope="package")
def artefacts() -> Path:
    """Where screenshots go; not committed."""
    ARTEFACTS.mkdir(parents=True, exist_ok=True)
    return ARTEFACTS
