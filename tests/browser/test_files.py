"""Video files: every frame once, with its own number and time, however the browser reads it."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from service.load.own import OwnServer

from .conftest import Open, loop
from .driver import Tracker
from .films import BOX, SIZE, even, film, number_of, uneven
from .tap import Tap

pytestmark = loop
PATIENCE_S = 120
FILMS: dict[str, Callable[[Path], list[float]]] = {
    "uneven.mp4": lambda path: film(path, uneven(60)),
    "two-a-second.mp4": lambda path: film(path, even(12, 2)),
    "quick.mp4": lambda path: film(path, even(60, 240)),
    "without-duration.webm": lambda path: film(path, even(40, 25), "libvpx", live="1"),
    "reordered.mkv": lambda path: film(path, uneven(40), bf="3"),
}
# As on a page of plain http, and in browsers without WebCodecs.
NO_DECODER = "delete globalThis.VideoDecoder"


async def followed(user: Tracker, path: Path) -> list[dict[str, object]]:
    """Follow the film's square to the end; the frames that were exported."""
    await user.open_file(path)
    await user.draw(BOX)
    await user.end(PATIENCE_S)
    frames: list[dict[str, object]] = (await user.boxes())["frames"]
    return frames


def sent(tap: Tap) -> list[int]:
    """Numbers of the pictures that went to the service, the first with the session."""
    images = [tap.created()[0], *(one for one in tap.streams()[-1][0] if isinstance(one, bytes))]
    return [number_of(cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_COLOR)) for image in images]  # type: ignore[arg-type]


@pytest.mark.parametrize("way", ["decoded", "by seeking"])
@pytest.mark.parametrize("name", FILMS)
async def test_each_frame_is_tracked_once_with_its_number_and_time(
    open_page: Open, server: OwnServer, tmp_path: Path, name: str, way: str
) -> None:
    times = FILMS[name](tmp_path / name)
    async with Tap(server.port) as tap, open_page(tap.url) as user:
        if way == "by seeking":
            await user.page.add_init_script(NO_DECODER)
            await user.page.reload()
        frames = await followed(user, tmp_path / name)
    assert [frame["frame"] for frame in frames] == list(range(len(times)))
    assert [frame["time_s"] for frame in frames] == pytest.approx(times, abs=1.5e-3)
    assert sent(tap) == list(range(len(times)))


async def test_frames_whose_numbers_cannot_be_known_have_none(open_page: Open, tmp_path: Path) -> None:
    """Without the library the browser tells the time of each frame and no more; it may leave short frames out."""
    times = film(tmp_path / "uneven.mp4", uneven(30))
    async with open_page() as user:
        user.expected += ["Failed to load resource", "net::ERR_FAILED"]
        await user.page.route("**/mediabunny*", lambda route: route.abort())
        frames = await followed(user, tmp_path / "uneven.mp4")
    told = [frame["time_s"] for frame in frames]
    assert {frame["frame"] for frame in frames} == {None}
    assert told == sorted(set(told))
    assert all(min(abs(time - one) for one in times) < 1.5e-3 for time in told)
    assert len(told) > len(times) / 2


async def test_numbers_stay_those_of_the_video_after_corrections(open_page: Open, tmp_path: Path) -> None:
    film(tmp_path / "even.mp4", even(80, 25))
    async with open_page() as user:
        await user.open_file(tmp_path / "even.mp4")
        await user.draw(BOX)
        await user.frames(8)
        await user.pause()
        box = (await user.boxes())["frames"][-1]["targets"][0]["box"]
        await user.drag((box[0] + 30, box[1] + 30), (box[0] + 36, box[1] + 30))  # a correction
        await user.until("document.getElementById('log').innerText.includes('corrected')")
        await user.draw((240, 150, 40, 40))  # another target
        await user.until("document.querySelectorAll('#targets li').length === 2")
        await user.page.keyboard.press("Space")
        await user.end(PATIENCE_S)
        lines = list(csv.DictReader((await user.export("csv")).read_text().splitlines()))
    numbers = [int(line["frame"]) for line in lines if line["target"] == "1"]
    assert numbers == list(range(80))
    assert all(float(line["time_s"]) == pytest.approx(int(line["frame"]) / 25, abs=1e-4) for line in lines)


async def test_steps_go_on_and_back_by_one_frame_of_an_uneven_film(open_page: Open, tmp_path: Path) -> None:
    times = film(tmp_path / "uneven.mp4", uneven(30))
    async with open_page() as user:
        await user.open_file(tmp_path / "uneven.mp4")
        seen = []
        for key in ".....,,,":
            await user.page.keyboard.press(key)
            await user.page.wait_for_timeout(150)
            image = cv2.imdecode(np.frombuffer(await user.pixels(), np.uint8), cv2.IMREAD_COLOR)
            assert image is not None
            seen.append(number_of(image))
        assert seen == [1, 2, 3, 4, 5, 4, 3, 2]
        # by a second, and not beyond either end
        for key, frame in (("l", at(times, times[2] + 1)), ("j", 2), ("j", 0)):
            await user.page.keyboard.press(key)
            place = f"frame {frame + 1} of 30"
            await user.until(f"document.getElementById('seek').getAttribute('aria-valuetext').endsWith('{place}')")
        await user.page.keyboard.press("k")
        await user.until("document.getElementById('play').getAttribute('aria-label') === 'Pause'")
        await user.page.keyboard.press("k")
        await user.until("document.getElementById('play').getAttribute('aria-label') === 'Play'")


def at(times: list[float], time: float) -> int:
    """Which frame is shown at a time."""
    return max(i for i, one in enumerate(times) if one <= time + 1e-6)


async def test_the_export_says_what_was_left_out_and_offers_the_rest(open_page: Open, tmp_path: Path) -> None:
    film(tmp_path / "long.mp4", even(120, 60))
    async with open_page() as user:
        await user.set("mode", "latest")
        await user.page.set_input_files("#file", tmp_path / "long.mp4")
        await user.until("document.documentElement.dataset.state === 'open'")
        # no machine answers to this rate
        await user.page.evaluate(
            "(() => { const send = WebSocket.prototype.send; WebSocket.prototype.send = function (d) {"
            " setTimeout(() => send.call(this, d), 60); }; })()"
        )
        await user.draw(BOX)
        await user.end(PATIENCE_S)
        tracked = len((await user.boxes())["frames"])
        assert tracked < 120
        assert 0 < int(await user.page.inner_text("#stat-dropped")) <= 120 - tracked
        await user.page.click("#open-export")
        assert f"{tracked} of 120 frames were tracked" in await user.page.inner_text("#covered")
        await user.page.keyboard.press("Escape")
        await user.set("mode", "auto")
        await user.page.click("#open-export")
        await user.page.click("#repeat")
        await user.end(PATIENCE_S)
        frames = (await user.boxes())["frames"]
        assert [frame["frame"] for frame in frames] == list(range(120))
        assert await user.page.locator("#runs li").count() == 2  # the first run is still there


async def test_a_recording_can_be_opened_again(open_page: Open, tmp_path: Path) -> None:
    """It has a duration, and each of its frames is tracked once."""
    async with open_page() as user:
        await user.follow_sample(3)
        await user.page.click("#record")
        await user.frames(30)
        async with user.page.expect_download() as saved:
            await user.page.click("#record")
        name = (await saved.value).suggested_filename
        await (await saved.value).save_as(tmp_path / name)
        await user.page.click("#change-source")
        await user.open_file(tmp_path / name)
        assert "Infinity" not in await user.page.inner_text("#clock")
        await user.draw(tuple(value * 1.0 for value in (278, 184, 84, 112)))
        await user.end(PATIENCE_S)
        numbers = [frame["frame"] for frame in (await user.boxes())["frames"]]
        assert numbers == list(range(len(numbers)))
        assert len(numbers) > 10


async def test_images_folders_and_zip_files_are_sources(open_page: Open, tmp_path: Path) -> None:
    import zipfile

    from .films import picture

    folder = tmp_path / "images"
    folder.mkdir()
    paths = [folder / f"{number}.png" for number in range(12)]  # 10 comes after 9
    for number, path in enumerate(paths):
        cv2.imwrite(str(path), picture(number)[:, :, ::-1])
    with zipfile.ZipFile(tmp_path / "images.zip", "w", zipfile.ZIP_DEFLATED) as packed:
        for path in paths:
            packed.write(path, f"folder/{path.name}")
    async with open_page() as user:
        for chosen in (paths, [tmp_path / "images.zip"], folder):
            if isinstance(chosen, Path):
                await user.page.set_input_files("#folder", chosen)
                await user.until("document.documentElement.dataset.state === 'open'")
            else:
                await user.open_file(*chosen)
            await user.draw(BOX)
            await user.end(PATIENCE_S)
            exported = await user.boxes()
            assert [frame["frame"] for frame in exported["frames"]] == list(range(12))
            assert exported["about"]["size"] == list(SIZE)
            await user.page.click("#change-source")
