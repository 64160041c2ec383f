"""Every example does what it says, against a real server."""

from __future__ import annotations

import asyncio
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import pytest

from mfcmt_core.images.decode import decode
from service.load.clips import LIMITS, Clip
from service.load.own import OwnServer
from tests.chromium import chromium
from tests.conftest import ROOT, require
from tests.service.jsclient.browser import CAMERA_FLAGS, PACKAGE, Pages, write_y4m
from tests.service.jsclient.conftest import HERE as JSCLIENT
from tests.service.jsclient.test_browser import overlap
from tests.service.live.conftest import Serve
from tests.service.live.test_main_job import in_process

from .rtsp import camera

EXAMPLES = ROOT / "docs" / "examples"
KEY = "a-key-for-the-examples-0123456789"
TIMEOUT_S = 180


def output(call: list[str], cwd: Path = EXAMPLES, **environment: str) -> str:
    """What it prints; it must succeed."""
    done = run(call, cwd, **environment)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def run(call: list[str], cwd: Path = EXAMPLES, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        call, cwd=cwd, env=os.environ | environment, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )


def comma(box: tuple[float, ...]) -> str:
    return ",".join(f"{v:g}" for v in box)


@pytest.fixture
def film(clip: Clip, tmp_path: Path) -> Path:
    """The clip as a video file that any OpenCV reads."""
    path = tmp_path / "clip.avi"
    size = tuple(side - side % 2 for side in clip.size)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, size)
    require(writer.isOpened(), "OpenCV writes no video here")
    for frame in clip.frames:
        writer.write(decode(frame, LIMITS)[0][: size[1], : size[0]])
    writer.release()
    return path


def test_the_curl_example_gives_the_library_s_boxes(own_server: Serve, clip: Clip, files: list[str]) -> None:
    require(shutil.which("curl"), "no curl")
    server = own_server(api_keys=KEY)
    call = ["sh", "track.sh", str(Path(files[0]).parent), comma(clip.box)]
    header, first, *lines = output(call, SERVICE=server.url, KEY=KEY).splitlines()
    assert header.startswith("seq,ts,target,x,y,w,h,status")
    assert [float(v) for v in first.split(",")[3:7]] == list(clip.box)
    said = in_process(clip, [clip.box])
    assert [[float(v) for v in line.split(",")[3:7]] for line in lines] == [list(one[0].box) for one in said]
    refused = run(call, SERVICE=server.url, KEY="not-the-key-0123456789abcdef")
    assert refused.returncode != 0
    assert "unauthenticated" in refused.stderr


def test_curl_takes_frames_in_the_order_of_their_numbers(
    server: OwnServer, clip: Clip, files: list[str], tmp_path: Path
) -> None:
    """img2.jpg before img10.jpg, as ``mfcmt track`` does; a space in a name is no end of it."""
    require(shutil.which("curl"), "no curl")
    folder = tmp_path / "my frames"
    folder.mkdir()
    for number, file in enumerate(files[:12], 1):
        shutil.copy(file, folder / f"img {number}.jpg")
    _, *lines = output(["sh", "track.sh", str(folder), comma(clip.box)], SERVICE=server.url).splitlines()
    said = in_process(clip, [clip.box])[:11]
    assert [[float(v) for v in line.split(",")[3:7]] for line in lines[1:]] == [list(one[0].box) for one in said]
    (folder / "img 3.jpg").write_bytes(b"no image")
    broken = run(["sh", "track.sh", str(folder), comma(clip.box)], SERVICE=server.url)
    assert broken.returncode != 0
    assert "img 3.jpg" in broken.stderr
    assert "unsupported-image" in broken.stderr
    empty = run(["sh", "track.sh", str(tmp_path / "nothing"), "1,2,3,4"], SERVICE=server.url)
    assert (empty.returncode, empty.stderr) == (1, f"no .jpg in {tmp_path / 'nothing'}\n")


def rows(text: str) -> list[tuple[int, int, list[float], str]]:
    parts = [line.split(",") for line in text.splitlines()]
    return [(int(p[0]), int(p[1]), [float(v) for v in p[2:6]], p[6]) for p in parts]


def test_the_python_example_tracks_several_targets_in_a_file(server: OwnServer, clip: Clip, film: Path) -> None:
    x, y, w, h = clip.box
    boxes = [comma(clip.box), comma((x + w / 4, y + h / 4, w / 2, h / 2))]
    printed = rows(output([sys.executable, "track_video.py", str(film), *boxes], SERVICE=server.url))
    assert [(seq, target) for seq, target, _, _ in printed] == [
        (n, t) for n in range(1, len(clip.frames)) for t in (0, 1)
    ]
    last, said = printed[-2][2], in_process(clip, [clip.box])[-1][0].box
    assert abs(last[0] - said[0]) < w / 4  # the film has been encoded twice more
    assert {status for *_, status in printed} <= {"tracking", "uncertain", "lost"}
    failed = run([sys.executable, "track_video.py", "no-such-file.mp4", "1,2,3,4"], SERVICE=server.url)
    assert failed.returncode != 0
    assert "No such file" in failed.stderr


def test_the_python_example_tracks_a_live_stream(server: OwnServer, clip: Clip) -> None:
    """RTSP, two targets: the newest frame wins, numbers rise, and what is found is where it is."""
    width, height = (side - side % 8 for side in clip.size)
    images = [decode(frame, LIMITS)[0][:height, :width] for frame in clip.frames]
    x, y, w, h = clip.box
    boxes = [comma(clip.box), comma((x + w / 4, y + h / 4, w / 2, h / 2))]
    with camera(images, fps=20) as url:
        done = run([sys.executable, "track_video.py", url, *boxes], SERVICE=server.url, RETRY="0")
    assert done.returncode == 1  # a camera that ends has gone
    assert done.stderr.startswith(f"{url} is gone: ")
    printed = rows(done.stdout)
    seqs = [seq for seq, target, *_ in printed if target == 0]
    assert seqs == sorted(set(seqs)) == [seq for seq, target, *_ in printed if target == 1]
    assert len(seqs) > 1  # how many more is a matter of the machine
    found = [box for _, target, box, _ in printed if target == 0]
    truth = [clip.box, *(one[0].box for one in in_process(clip, [clip.box]))]
    # Which frames of the film they were the camera does not tell: each box is near one of the truth.
    near = [max(overlap(box, one) for one in truth) for box in found]
    assert sum(near) / len(near) > 0.8


def test_the_node_example_gives_the_library_s_boxes(
    own_server: Serve, node: str, clip: Clip, files: list[str], tmp_path: Path
) -> None:
    """As somebody runs it who has installed the package and `ws`."""
    server = own_server(api_keys=KEY)
    modules = tmp_path / "app" / "node_modules"
    shutil.copytree(PACKAGE, modules / "@mfcmt" / "client")
    (modules / "ws").symlink_to(JSCLIENT / "node_modules" / "ws")
    example = shutil.copy(EXAMPLES / "track.mjs", tmp_path / "app")
    printed = output([node, str(example), comma(clip.box), *files], SERVICE=server.url, KEY=KEY)
    results = [json.loads(line) for line in printed.splitlines()]
    assert [r["box"] for r in results] == [list(one[0].box) for one in in_process(clip, [clip.box])]
    refused = run([node, str(example), comma(clip.box), *files], SERVICE=server.url)
    assert refused.returncode == 1
    assert refused.stderr.startswith("unauthenticated")


def test_an_old_node_is_refused_in_one_line(node: str, tmp_path: Path) -> None:
    """The version is feigned; the check comes before anything is loaded that an old Node does not know."""
    old = tmp_path / "old.cjs"
    old.write_text('Object.defineProperty(process.versions, "node", { value: "18.20.0" });')
    printed = run([node, "--require", str(old), "track.mjs", "1,2,3,4", "a.jpg", "b.jpg"])
    assert (printed.returncode, printed.stderr) == (1, "Node 20 or newer is needed; this is 18.20.0\n")
    engines = json.loads((PACKAGE / "package.json").read_text())["engines"]
    assert engines == {"node": ">=20"}


def test_node_without_the_package_says_what_to_install(node: str, tmp_path: Path) -> None:
    example = shutil.copy(EXAMPLES / "track.mjs", tmp_path)
    printed = run([node, str(example), "1,2,3,4", "a.jpg", "b.jpg"], cwd=tmp_path)
    assert printed.returncode == 1
    assert printed.stderr.splitlines()[-1] == "npm install http://127.0.0.1:8000/static/mfcmt-client.tgz"
    assert "at " not in printed.stderr.splitlines()[-1]
    usage = run([node, str(example)], cwd=tmp_path)
    assert (usage.returncode, usage.stderr) == (1, "node track.mjs x,y,w,h FRAME FRAME...\n")


async def test_the_example_page_tracks_a_camera(clip: Clip, tmp_path: Path) -> None:
    """A box drawn by mouse over a camera, then put right by drawing again."""
    path = chromium()
    playwright: Any = pytest.importorskip("playwright.async_api")
    film = tmp_path / "camera.y4m"
    write_y4m(film, [decode(clip.frame(index), LIMITS)[0] for index in range(2 * len(clip.frames) - 2)])
    camera = f"--use-file-for-fake-video-capture={film}"
    policy = "default-src 'self'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; connect-src *"
    with Pages(clip.frames, policy, root=EXAMPLES) as pages, OwnServer(lanes=1, allowed_origins=pages.origin) as server:
        async with playwright.async_playwright() as driver:
            browser = await driver.chromium.launch(executable_path=path, args=[*CAMERA_FLAGS, camera])
            try:
                page = await (await browser.new_context(permissions=["camera"])).new_page()
                errors: list[str] = []
                page.on("pageerror", lambda error: errors.append(str(error)))
                page.on("console", lambda line: line.type == "error" and errors.append(line.text))
                await page.goto(f"{pages.origin}/track.html?service={server.url}")
                expect = playwright.expect
                while not (width := await page.evaluate("document.querySelector('video').videoWidth")):
                    await asyncio.sleep(0.02)
                area = await page.locator("video").bounding_box()
                scale = area["width"] / width
                x, y, w, h = (v * scale for v in clip.box)

                async def draw() -> None:
                    await page.mouse.move(area["x"] + x, area["y"] + y)
                    await page.mouse.down()
                    await page.mouse.move(area["x"] + x + w, area["y"] + y + h)
                    await page.mouse.up()

                await draw()
                text = page.locator("p")
                await expect(text).to_contain_text("a second", timeout=30_000)
                await expect(page.locator("svg rect")).to_be_visible()
                before = int(re.findall(r"frame (\d+)", await text.inner_text())[0])
                await draw()
                for _ in range(3000):
                    found = re.findall(r"frame (\d+)", await text.inner_text())
                    if found and int(found[0]) > before + 20:
                        break
                    await asyncio.sleep(0.01)
                else:
                    pytest.fail(f"no more frames: {await text.inner_text()}")
                assert errors == []
            finally:
                await browser.close()


def test_the_readme_names_all_examples() -> None:
    named = set(re.findall(r"\]\((\w+\.(?:html|mjs|py|sh))\)", (EXAMPLES / "README.md").read_text()))
    assert named == {path.name for path in EXAMPLES.iterdir()} - {"README.md", "frames"}
