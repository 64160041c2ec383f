"""Apps that are built with the packed client, by the tools that people build with, and run where they can be."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest

from service.client import AsyncClient
from service.load.clips import Clip
from service.load.own import OwnServer
from tests.chromium import FLAGS, chromium
from tests.conftest import require
from tests.service.live.test_main_job import in_process

from .browser import Pages
from .conftest import HERE, PACKAGE, node_with
from .test_browser import overlap, overlaps

APPS = HERE / "apps"
POLICY = "default-src 'self'; connect-src *; img-src data:"


def run(*call: object, cwd: Path) -> str:
    done = subprocess.run([*map(str, call)], cwd=cwd, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def app(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the app's sources and the packed client installed."""
    node_with(APPS)
    npm = shutil.which("npm")
    require(npm, "no npm")
    folder = tmp_path_factory.mktemp("app")
    for source in APPS.glob("*.*"):
        if source.name not in ("package.json", "package-lock.json"):
            shutil.copy(source, folder)
    (folder / "package.json").write_text('{"type": "module"}')
    modules = folder / "node_modules"
    (modules / "@mfcmt").mkdir(parents=True)
    packed = run(npm, "pack", "--silent", PACKAGE, cwd=folder).strip().splitlines()[-1]
    run("tar", "xzf", packed, cwd=folder)
    (folder / "package").rename(modules / "@mfcmt" / "client")
    # Metro reads nothing outside of the app; the tools themselves may lie elsewhere.
    shutil.copytree(APPS / "node_modules" / "@babel" / "runtime", modules / "@babel" / "runtime")
    for there in (APPS / "node_modules").iterdir():
        if not (modules / there.name).exists():
            (modules / there.name).symlink_to(there)
    return folder


def built(app: Path, tool: str) -> Path:
    output = app / "built" / tool
    output.mkdir(parents=True)
    run("node", "build.mjs", tool, output, cwd=app)
    return output


@asynccontextmanager
async def opened(folder: Path, server: OwnServer, clip: Clip, policy: str) -> AsyncIterator[tuple[Any, list[str]]]:
    """The app in a folder, in a browser; and the lines of its console."""
    path = chromium()
    playwright: Any = pytest.importorskip("playwright.async_api")
    with Pages(clip.frames, policy, root=folder) as pages:
        given = {"service": server.url, "frames": pages.frame_urls, "box": clip.box}
        async with playwright.async_playwright() as driver:
            browser = await driver.chromium.launch(executable_path=path, args=FLAGS)
            try:
                page = await browser.new_page()
                lines: list[str] = []
                page.on("console", lambda line: lines.append(line.text))
                page.on("pageerror", lambda error: lines.append(f"uncaught: {error}"))
                await page.goto(f"{pages.origin}/page.html#{quote(json.dumps(given))}")
                yield page, lines
            finally:
                await browser.close()


async def tracked(folder: Path, server: OwnServer, clip: Clip, policy: str = POLICY) -> dict[str, Any]:
    """What the app in a folder tells when it has tracked all frames."""
    async with opened(folder, server, clip, policy) as (page, lines):
        report: dict[str, Any] = await told(page, "window.report")
    assert "error" not in report, report
    return {**report, "console": lines}


async def told(page: Any, expression: str) -> Any:
    """The value of an expression as soon as it is true."""
    while not (value := await page.evaluate(f"({expression}) || null")):
        await asyncio.sleep(0.02)
    return value


@pytest.fixture(scope="module")
def service() -> Iterator[OwnServer]:
    """Lets pages of this machine in, as somebody who develops one has it."""
    with OwnServer(lanes=1, allowed_origins="localhost", operation_deadline_s=60) as own:
        yield own


@pytest.mark.parametrize("tool", ["vite", "webpack", "esbuild"])
async def test_a_built_app_encodes_in_a_worker(app: Path, service: OwnServer, clip: Clip, tool: str) -> None:
    """esbuild leaves the worker's file behind: then it is made from its text, which needs blob: in the policy."""
    policy = f"{POLICY}; worker-src 'self' blob:" if tool == "esbuild" else POLICY
    report = await tracked(built(app, tool), service, clip, policy)
    assert report["encoder"] == "worker"
    assert np.mean(overlaps(report["boxes"], clip)) > 0.85
    assert report["area"] == [0, 25, 100, 50]
    assert not any("main thread" in line for line in report["console"])


async def test_a_worker_that_cannot_start_is_told_once(app: Path, service: OwnServer, clip: Clip) -> None:
    """Under a policy without blob:, an app of esbuild says what to do; the main thread encodes."""
    report = await tracked(built(app, "esbuild-strict"), service, clip, f"{POLICY}; worker-src 'self'")
    assert report["encoder"] == "main"
    (told,) = [line for line in report["console"] if line.startswith("MFCMT: ")]
    assert "workerUrl" in told
    assert np.mean(overlaps(report["boxes"], clip)) > 0.85


async def test_esbuild_builds_the_worker_as_a_file_of_its_own(app: Path, service: OwnServer, clip: Clip) -> None:
    """As the warning says: under `worker-src 'self'`, with `workerUrl`."""
    report = await tracked(built(app, "esbuild-worker"), service, clip, f"{POLICY}; worker-src 'self'")
    assert report["encoder"] == "worker"
    assert np.mean(overlaps(report["boxes"], clip)) > 0.85


async def test_a_react_app_tracks_what_is_drawn_and_leaves_no_session(
    app: Path, service: OwnServer, clip: Clip
) -> None:
    """In StrictMode: a box drawn over a letterboxed video, its target over the video; unmounting ends the session."""
    policy = f"{POLICY}; worker-src 'self' blob:; style-src 'self' 'unsafe-inline'; media-src *"
    async with opened(built(app, "react"), service, clip, policy) as (page, lines):
        await told(page, "document.querySelector('video')?.videoWidth")
        area = await page.locator("video").bounding_box()
        width, height = clip.size
        scale = min(600 / width, 300 / height)
        left, top = area["x"] + (600 - width * scale) / 2, area["y"] + (300 - height * scale) / 2
        x, y, w, h = (value * scale for value in clip.box)
        await page.mouse.move(left + x, top + y)
        await page.mouse.down()
        await page.mouse.move(left + x + w, top + y + h)
        await page.mouse.up()
        await told(page, "window.tracker.stream?.stats.answered > 10")
        await told(page, "document.querySelector('svg rect')?.getBoundingClientRect().width > 0")
        shown = await page.locator("svg rect").bounding_box()
        state = await page.evaluate("({ ...window.tracker, stream: null, size: window.tracker.size })")
        sessions = await page.evaluate("window.tracker.stream.info.session.id")
        async with AsyncClient(service.url) as client:
            assert sessions in {one.id async for one in client.sessions()}
            await page.evaluate("window.unmount()")
            while sessions in {one.id async for one in client.sessions()}:
                await asyncio.sleep(0.02)
            assert [one.id async for one in client.sessions()] == []
    assert state["status"] == "open"
    assert state["error"] is None
    assert state["size"] == list(clip.size)
    found = [(shown["x"] - left) / scale, (shown["y"] - top) / scale, shown["width"] / scale, shown["height"] / scale]
    assert overlap(found, clip.box) > 0.4  # it has moved on a little
    assert [line for line in lines if "Warning" in line or "uncaught" in line] == []


@pytest.fixture(scope="module")
def native(app: Path) -> Path:
    """The bundle that Metro makes for React Native."""
    return built(app, "metro") / "native.js"


def test_hermes_compiles_what_metro_bundles(app: Path, native: Path) -> None:
    """Hermes reads no `import.meta`; the release build of every React Native app goes this way."""
    assert "import.meta" not in native.read_text()
    hermesc = APPS / "node_modules" / "hermes-compiler" / "hermesc" / "linux64-bin" / "hermesc"
    hermesc.chmod(0o755)
    bytecode = native.with_suffix(".hbc")
    run(hermesc, "-emit-binary", "-out", bytecode, native, cwd=app)
    assert bytecode.stat().st_size > 10_000


def test_the_native_bundle_tracks_without_what_react_native_lacks(
    app: Path, native: Path, service: OwnServer, clip: Clip, files: list[str]
) -> None:
    """The bundle runs in Node with what React Native has, too: without URL, Blob, crypto and TextEncoder."""
    given = {"service": service.url, "box": clip.box, "frames": files}
    (app / "given.json").write_text(json.dumps(given))
    shutil.copytree(HERE / "node_modules" / "ws", app / "node_modules" / "ws", dirs_exist_ok=True)
    report = json.loads(run("node", "run-native.mjs", native, "given.json", cwd=app))
    assert report["ts"] == 17.5
    assert report["label"] == "Grüße"
    assert report["boxes"] == [list(one[0].box) for one in in_process(clip, [clip.box])]
