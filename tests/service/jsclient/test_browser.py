"""The JavaScript client in a real browser against a real server."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mfcmt_core.images.decode import decode
from service.load.clips import LIMITS, Clip
from service.load.own import OwnServer
from tests.chromium import chromium
from tests.service.live.cable import Cable
from tests.service.live.test_main_job import in_process

from .browser import CAMERA_FLAGS, Pages, write_y4m

Run = Callable[..., Awaitable[Any]]
STRICT = "default-src 'none'; script-src 'self'; worker-src 'self'; img-src data:; connect-src 'self' http: ws:"
PHONE = "Mozilla/5.0 (Linux; Android 14; Pixel 8) AppleWebKit/537.36 Chrome/130.0 Mobile Safari/537.36"


@pytest.fixture(scope="module")
def pages(clip: Clip) -> Iterator[Pages]:
    with Pages(clip.frames, STRICT) as served:
        yield served


@pytest.fixture(scope="module")
def service(pages: Pages) -> Iterator[OwnServer]:
    """Accepts the page's origin, which is not its own."""
    with OwnServer(lanes=2, max_sessions_per_lane=64, allowed_origins=pages.origin) as own:
        yield own


@asynccontextmanager
async def opened(pages: Pages, url: str, *flags: str, **context: Any) -> AsyncIterator[tuple[Run, Any]]:
    """The harness in a browser of its own. What the console says of errors fails the test."""
    path = chromium()
    playwright = pytest.importorskip("playwright.async_api")
    async with playwright.async_playwright() as driver:
        browser = await driver.chromium.launch(executable_path=path, args=[*CAMERA_FLAGS, *flags])
        try:
            page = await (await browser.new_context(**context)).new_page()
            page.set_default_timeout(120_000)
            errors: list[str] = []
            page.on("pageerror", lambda error: errors.append(str(error)))
            await page.goto(f"{pages.origin}/harness.html")
            while not await page.evaluate("window.up"):
                await asyncio.sleep(0.01)

            async def run(name: str, clip: Clip, **given: Any) -> Any:
                particulars = {"url": url, "frames": pages.frame_urls, "box": clip.box} | given
                return await page.evaluate("([name, given]) => window.run(name, given)", [name, particulars])

            yield run, page  # its policy forbids strings as code, so `wait_for_function` does not work
            assert errors == []
        finally:
            await browser.close()


def overlap(a: list[float], b: tuple[float, ...]) -> float:
    """Intersection over union."""
    across = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    down = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    both = max(across, 0.0) * max(down, 0.0)
    return both / (a[2] * a[3] + b[2] * b[3] - both)


def overlaps(boxes: list[list[float]], clip: Clip) -> list[float]:
    """With the library's boxes on the same frames; the browser has encoded them anew."""
    said = in_process(clip, [clip.box])
    assert len(boxes) == len(said)
    return [overlap(box, one[0].box) for box, one in zip(boxes, said, strict=True)]


async def test_encoded_frames_are_sent_as_they_are(pages: Pages, service: OwnServer, clip: Clip) -> None:
    said = [list(one[0].box) for one in in_process(clip, [clip.box])]
    async with opened(pages, service.url) as (run, _):
        for kind, codec in (("blob", "json"), ("bytes", "msgpack")):
            report = await run("frames", clip, kind=kind, stream={"codec": codec})
            assert report["boxes"] == said
            assert report["encoder"] is None


async def test_pixels_are_encoded_off_the_main_thread(pages: Pages, service: OwnServer, clip: Clip) -> None:
    """A worker does it, under a policy of `script-src 'self'; worker-src 'self'`."""
    async with opened(pages, service.url) as (run, page):
        report = await run("frames", clip, kind="canvas", stream={"regions": False})
        assert report["encoder"] == "worker"
        assert any("encoder-worker.js" in worker.url for worker in page.workers) or not page.workers
    assert report["violations"] == []
    assert report["problems"] == []
    assert np.mean(overlaps(report["boxes"], clip)) > 0.85
    assert report["stats"]["encodeMs"] > 0
    assert report["stats"]["bytesSaved"] == 0


async def test_without_workers_the_main_thread_encodes(service: OwnServer, pages: Pages, clip: Clip) -> None:
    """A policy without workers, and the same boxes all the same."""
    policy = STRICT.replace("worker-src 'self'", "worker-src 'none'")
    with Pages(clip.frames, policy) as strict, OwnServer(lanes=1, allowed_origins=strict.origin) as own:
        async with opened(strict, own.url) as (run, _):
            fallen = await run("frames", clip, kind="canvas", stream={"imageType": "image/png"})
            assert fallen["encoder"] == "main"
    async with opened(pages, service.url) as (run, _):
        worked = await run("frames", clip, kind="canvas", stream={"imageType": "image/png"})
        asked = await run("frames", clip, kind="canvas", stream={"imageType": "image/png", "encoder": "main"})
    assert (worked["encoder"], asked["encoder"]) == ("worker", "main")
    assert fallen["boxes"] == worked["boxes"] == asked["boxes"]


@pytest.mark.parametrize("kind", ["bitmap", "videoframe", "imagedata", "offscreen"])
async def test_every_kind_of_pixels_is_tracked(pages: Pages, service: OwnServer, clip: Clip, kind: str) -> None:
    async with opened(pages, service.url) as (run, _):
        kept = await run("frames", clip, kind=kind, stream={"quality": 0.95})
        moved = await run("frames", clip, kind=kind, stream={"quality": 0.95}, transfer=True)
    assert kept["boxes"] == moved["boxes"]
    assert np.mean(overlaps(kept["boxes"], clip)) > 0.85


async def test_regions_give_the_same_boxes_for_fewer_bytes(pages: Pages, service: OwnServer, clip: Clip) -> None:
    """Without coding noise (PNG) they are equal; bytes sent and saved are those of whole frames."""
    async with opened(pages, service.url) as (run, _):
        whole = await run("frames", clip, stream={"imageType": "image/png", "regions": False})
        cut = await run("frames", clip, stream={"imageType": "image/png", "regions": True})
    assert cut["boxes"] == whole["boxes"]
    assert cut["problems"] == []
    sent, saved = cut["stats"]["bytesSent"], cut["stats"]["bytesSaved"]
    assert sent < 0.9 * whole["stats"]["bytesSent"]
    assert sent + saved == pytest.approx(whole["stats"]["bytesSent"], rel=0.15)


async def test_regions_save_bytes_in_latest_too(pages: Pages, service: OwnServer, clip: Clip) -> None:
    async with opened(pages, service.url) as (run, _):
        stream = {"mode": "latest", "regions": True}
        report = await run("resumed", clip, kind="canvas", stream=stream, everyMs=20)
    stats = report["stats"]
    assert stats["answered"] > 20
    assert stats["bytesSaved"] > 0
    assert stats["refused"] <= stats["sent"] // 4


@pytest.mark.parametrize("mode", ["latest", "lossless"])
async def test_a_target_outside_of_the_cut_makes_the_next_frame_whole(
    pages: Pages, service: OwnServer, clip: Clip, mode: str
) -> None:
    """The frame that a new target needs is sent whole, unasked."""
    width, height = clip.size
    other = [4, 4, width / 8, height / 8] if clip.box[0] > width / 2 else [width * 0.85, height * 0.8, 30, 30]
    async with opened(pages, service.url) as (run, _):
        report = await run("elsewhere", clip, other=other, mode=mode)
    assert report["region"] is not None
    assert report["ids"] == [0, 1]
    assert report["targets"] == 2
    assert report["saved"] > 0


async def test_regions_are_for_mobiles(pages: Pages, service: OwnServer, clip: Clip) -> None:
    async with opened(pages, service.url) as (run, _):
        assert await run("byDefault", clip) is False
    async with opened(pages, service.url, user_agent=PHONE, is_mobile=True, has_touch=True) as (run, _):
        assert await run("byDefault", clip) is True
        report = await run("frames", clip, kind="canvas")
    assert report["stats"]["bytesSaved"] > 0


async def test_frames_are_scaled_to_what_was_asked(pages: Pages, service: OwnServer, clip: Clip) -> None:
    max_side = 240
    async with opened(pages, service.url) as (run, _):
        report = await run("scaled", clip, size=clip.size, maxSide=max_side)
    assert max(report["fitted"]) == max_side
    assert report["fitted"] == report["encoded"] == report["size"] == report["after"]
    assert report["bytes"] > 0
    boxes = [[v / report["scale"] for v in box] for box in report["boxes"]]
    assert np.mean(overlaps(boxes, clip)) > 0.7


async def test_a_camera_is_followed_frame_by_frame(
    pages: Pages, service: OwnServer, clip: Clip, tmp_path: Path
) -> None:
    """A film in place of the camera, frame by frame through `<video>`."""
    film = tmp_path / "camera.y4m"
    write_y4m(film, [decode(clip.frame(index), LIMITS)[0] for index in range(2 * len(clip.frames) - 2)])
    camera = f"--use-file-for-fake-video-capture={film}"
    async with opened(pages, service.url, camera, permissions=["camera"]) as (run, _):
        report = await run("follow", clip, stream={"mode": "latest", "codec": "msgpack"}, fps=15, count=40)
    assert len(report["seqs"]) == report["boxes"] == 40
    assert report["seqs"] == sorted(report["seqs"])
    assert report["skipped"] is None
    assert report["taken"] is not None
    assert report["ofTrack"] == report["taken"] + 1
    stats = report["stats"]
    assert stats["sent"] == stats["answered"] + stats["dropped"]
    assert stats["skipped"] >= 1
    assert report["encoder"] == "worker"
    assert report["violations"] == []


async def test_refusals_are_readable_by_a_page(pages: Pages, service: OwnServer, clip: Clip) -> None:
    async with opened(pages, service.url) as (run, _):
        report = await run("refusals", clip)
    assert {name: problem["code"] for name, problem in report.items()} == {
        "elsewhere": "attached-elsewhere",
        "taken": "attached-elsewhere",
        "nobody": "session-not-found",
        "ticket": "unauthenticated",
        "source": "unsupported-source",
        "closed": "session-gone",
        "gone": "session-gone",
    }
    assert report["gone"]["reason"] == "closed"


@pytest.mark.parametrize(("mode", "kind"), [("lossless", "blob"), ("lossless", "canvas"), ("latest", "canvas")])
async def test_a_stream_is_resumed_through_cuts(
    pages: Pages, service: OwnServer, clip: Clip, mode: str, kind: str
) -> None:
    async with Cable(service.port) as cable:

        async def cutter(page: Any) -> None:
            for results, harm in ((8, cable.cut), (20, cable.cut), (30, cable.go_dead)):
                while (await page.evaluate("window.results ?? 0")) < results:
                    await asyncio.sleep(0.01)
                harm()

        async with opened(pages, cable.url) as (run, page):
            cutting = asyncio.create_task(cutter(page))
            stream = {"mode": mode, "regions": kind == "canvas"}
            report = await run("resumed", clip, kind=kind, stream=stream, everyMs=30)
            await cutting
    assert report["stats"]["reconnects"] >= 3
    assert report["statuses"].count("resuming") >= 3
    assert report["statuses"][-1] == "closed"
    seqs = [seq for seq, _ in report["boxes"]]
    assert seqs == sorted(set(seqs))
    assert seqs[-1] == report["seq"]
    if mode == "lossless":
        assert len(seqs) == len(clip.frames) - 1
        if kind == "blob":
            assert [box for _, box in report["boxes"]] == [list(one[0].box) for one in in_process(clip, [clip.box])]
        else:
            assert np.mean(overlaps([box for _, box in report["boxes"]], clip)) > 0.85
