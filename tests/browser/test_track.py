"""Boxes drawn on a camera's picture and on the sample clip, and what becomes of them."""

from __future__ import annotations

import csv
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mfcmt_core import MFCMT, synthetic
from mfcmt_core.images.decode import decode
from service.load.clips import LIMITS
from service.load.own import OwnServer
from tests.conftest import OTB_ROOT

from .conftest import CAMERA, Open, loop
from .driver import Box
from .tap import Tap

pytestmark = loop
BALLOON: Box = (278, 184, 84, 112)
GREEN: Box = (520, 106, 40, 56)  # the green balloon at the beginning of the sample clip
MAPS = {"fused", "gray", "fhog", "color_names", "background", "statistical"}


def iou(a: Any, b: Any) -> float:
    """Intersection over union of two boxes."""
    w = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    h = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    shared = max(w, 0) * max(h, 0)
    return float(shared / (a[2] * a[3] + b[2] * b[3] - shared))


def shown(png: bytes, frames: list[bytes]) -> int:
    """Which of ``frames`` the picture is."""

    def small(data: bytes) -> np.ndarray:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        return cv2.resize(image, (64, 48), interpolation=cv2.INTER_AREA).astype(np.float32)

    picture = small(png)
    return int(np.argmin([np.abs(picture - small(frame)).mean() for frame in frames]))


@pytest.mark.parametrize("regions", [False, True])
async def test_boxes_on_a_camera_equal_those_of_the_library(
    open_page: Open, server: OwnServer, camera_frames: list[bytes], artefacts: Path, regions: bool
) -> None:
    """Hundreds of frames of a real sequence: the boxes are those of the tracker in this process on the same bytes."""
    truth = np.loadtxt(OTB_ROOT / CAMERA / "groundtruth_rect.txt", delimiter=",") - [1, 1, 0, 0]
    async with Tap(server.port) as tap, open_page(tap.url) as user:
        await user.set("regions", regions)
        await user.choose("camera")
        await user.until("document.getElementById('picture').width > 100")
        await user.page.keyboard.press("Space")  # so that the box is drawn on a frame that is known
        x, y, w, h = truth[shown(await user.pixels(), camera_frames)]
        # a region of a face would be nearly the whole of these small frames; of an eye it is not
        await user.draw((x + 0.2 * w, y + 0.35 * h, 0.3 * w, 0.2 * h) if regions else (x, y, w, h))
        await user.frames(250 if not regions else 120)
        assert await user.status() in ("tracking", "uncertain", "lost")
        saved = await user.page.inner_text("#stat-saved")
        assert ("%" in saved) == regions, saved
        await user.page.screenshot(path=artefacts / f"camera{'-regions' if regions else ''}.png")
        await user.page.click("#stop")
    sent, heard = tap.streams()[-1]
    tracker, boxes = MFCMT(), {}
    numbers, region, seq = {}, None, 0
    for message in sent:
        if isinstance(message, bytes):
            seq = numbers.get("seq") or seq + 1
            boxes[seq] = (message, numbers.get("region"))
            numbers = {}
        elif message["type"] == "meta":
            numbers = message
    first, (start,) = tap.created()
    image, info = decode(first, LIMITS)
    size = (info.width, info.height)
    tracker.init(image, start)
    results = [message for message in heard if message["type"] == "result"]
    overlaps = []
    for result in results:
        data, region = boxes[result["seq"]]
        image, _ = decode(data, LIMITS)
        mine = tracker.update(image, offset=tuple(region[:2]) if region else (0, 0), frame_size=size)
        overlaps.append(iou(mine.box, result["targets"][0]["box"]))
    assert len(overlaps) >= (250 if not regions else 120)
    assert min(overlaps) > 0.999
    assert any(region for _, region in boxes.values()) == regions
    # and they are on the face: frames are found again by how they look
    if not regions:
        some = [(boxes[r["seq"]][0], r["targets"][0]["box"]) for r in results[:200:20]]
        near = [iou(truth[shown(data, camera_frames)], box) for data, box in some]
        assert np.mean(near) > 0.5, near


async def test_targets_of_the_sample_clip_are_added_corrected_and_removed(open_page: Open, artefacts: Path) -> None:
    """Drawn, added, corrected, chosen, removed; the balloon's path is the true one."""
    async with open_page() as user:
        await user.choose("sample")
        await user.draw(BALLOON)
        await user.frames(15)
        await user.page.keyboard.press("Space")
        await user.draw(GREEN)
        await user.until("document.querySelectorAll('#targets li').length === 2")
        await user.page.keyboard.press("Space")
        await user.frames(60)
        assert await user.status(1) == "tracking"
        assert "Target 2 started" in await user.log()
        assert await user.page.locator("#maps figure").count() == len(MAPS)
        await user.page.screenshot(path=artefacts / "two-targets.png")

        await user.page.keyboard.press("Space")
        exported = await user.boxes()
        x, y, w, h = exported["frames"][-1]["targets"][0]["box"]
        truth = synthetic.clip("sample").boxes
        assert iou((x, y, w, h), truth[round(exported["frames"][-1]["time_s"] * 30) % 300]) > 0.6
        await user.page.keyboard.press("1")
        await user.drag((x + w / 2, y + h / 2), (x + w / 2 + 3, y + h / 2 + 3))
        await user.until("document.getElementById('log').innerText.includes('corrected')")
        exported = await user.boxes()
        assert exported["frames"][-1]["targets"][0]["box"] == pytest.approx((x + 3, y + 3, w, h), abs=1.5)

        await user.page.click("#targets li[data-target='2'] [data-does=remove]")
        await user.until("document.querySelectorAll('#targets li').length === 1")
        await user.page.keyboard.press("Space")
        await user.frames(5)
        assert await user.status(2) is None


async def test_lossless_answers_every_frame_of_a_file(open_page: Open) -> None:
    async with open_page() as user:
        await user.set("mode", "lossless")
        await user.follow_sample(45)
        await user.page.keyboard.press("Space")
        await user.page.keyboard.press(".")
        exported = await user.boxes()
        times = [frame["time_s"] for frame in exported["frames"]]
        assert all(b - a == pytest.approx(1 / 30, abs=2e-3) for a, b in pairwise(times)), times
        assert await user.page.inner_text("#stat-dropped") == "0"


async def test_a_step_goes_on_by_one_frame(open_page: Open) -> None:
    async with open_page() as user:
        await user.follow_sample(5)
        await user.page.click("#play")
        before = (await user.boxes())["frames"]
        for count in (1, 2, 3):
            await user.page.click("#step")
            await user.until(f"document.getElementById('stage').dataset.frames == {len(before) + count}")
        after = (await user.boxes())["frames"]
        assert after[-1]["time_s"] - before[-1]["time_s"] == pytest.approx(0.1, abs=0.036)


async def test_a_video_file_is_tracked_to_its_end(open_page: Open, camera_frames: list[bytes], tmp_path: Path) -> None:
    film = tmp_path / "david.webm"
    writer = cv2.VideoWriter(str(film), cv2.VideoWriter.fourcc(*"VP80"), 25.0, (320, 240))
    for data in camera_frames[:50]:
        writer.write(decode(data, LIMITS)[0])
    writer.release()
    async with open_page() as user:
        await user.set("mode", "lossless")
        await user.page.set_input_files("#file", film)
        await user.until("document.documentElement.dataset.state === 'open'")
        await user.draw((129, 80, 64, 78))
        await user.until("document.getElementById('hint').innerText.includes('End of the video')")
        exported = await user.boxes()
        assert len(exported["frames"]) == 50
        assert (exported["frames"][0]["size"], exported["source"]) == ([320, 240], "david.webm")
        lines = list(csv.DictReader((await user.export("csv")).read_text().splitlines()))
        assert [float(line["time_s"]) for line in lines] == pytest.approx([i / 25 for i in range(50)], abs=2e-3)
        assert {line["target"] for line in lines} == {"1"}
        assert float(lines[-1]["fused"]) > 0
        await user.page.click("#play")  # what was tracked is shown from the beginning, and stays
        await user.until("document.getElementById('hint').innerText === ''")
        assert len((await user.boxes())["frames"]) == 50


async def test_a_file_that_is_no_video_is_refused(open_page: Open, tmp_path: Path) -> None:
    wrong = tmp_path / "film.mp4"
    wrong.write_bytes(b"not a film" * 100)
    async with open_page() as user:
        await user.page.set_input_files("#file", wrong)
        await user.until("!document.getElementById('notice').hidden")
        assert "cannot be played here" in await user.notice()


async def test_a_recording_shows_the_boxes(open_page: Open) -> None:
    async with open_page() as user:
        await user.follow_sample(3)
        await user.page.click("#record")
        await user.page.wait_for_selector("#recording", state="visible")
        await user.frames(90)  # a busy machine records one in eight of them
        async with user.page.expect_download() as saved:
            await user.page.click("#record")
        download = await saved.value
        assert download.suggested_filename.endswith((".webm", ".mp4"))
        film = cv2.VideoCapture(str(await download.path()))
        seen = []
        while (read := film.read())[0]:
            assert read[1].shape == (480, 640, 3)
            off = np.abs(read[1].astype(int) - (151, 220, 61)).max(axis=2)  # the colour of box and label, BGR
            seen.append((off < 40).sum())
        assert len(seen) > 5
        assert max(seen) > 100, seen


async def test_response_maps_are_sent_only_if_wanted(open_page: Open, server: OwnServer) -> None:
    async with Tap(server.port) as tap, open_page(tap.url) as user:
        await user.follow_sample(5)
        assert await user.page.locator("#maps figure").count() == len(MAPS)
        await user.set("maps", False)  # a new session, from where the target is
        await user.frames(10)
        assert not await user.page.is_visible("#maps-card")
        assert await user.status(1) in ("tracking", "uncertain")
    (_, with_maps), (_, without) = tap.streams()[-2:]
    results = [[m for m in heard if m["type"] == "result"] for heard in (with_maps, without)]
    assert set(results[0][0]["targets"][0]["maps"]) >= MAPS
    assert all("maps" not in result["targets"][0] for result in results[1])
