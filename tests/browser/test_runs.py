"""Nobody's work vanishes unasked: runs, new targets, corrections, undo."""

from __future__ import annotations

import asyncio
import json
import re
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from mfcmt_core.interpolate import join
from mfcmt_core.otb.metrics import success_curve
from tests.conftest import require

from .conftest import Open, loop
from .driver import Tracker
from .films import BOX, even, film, picture, times_of
from .test_access import violations
from .test_track import BALLOON, GREEN, iou

pytestmark = loop
COUNT = 60
TWO = "document.querySelectorAll('#targets li').length === 2"


async def begun(user: Tracker, folder: Path) -> None:
    film(folder / "film.mp4", even(COUNT, 25))
    await user.open_file(folder / "film.mp4")
    await user.draw(BOX)


async def of(user: Tracker, target: int) -> dict[int, list[float]]:
    """The boxes of a target by the number of the frame."""
    frames = (await user.boxes())["frames"]
    return {f["frame"]: row["box"] for f in frames for row in f["targets"] if row["target"] == target}


async def test_a_new_box_is_a_new_target_and_the_chosen_one(open_page: Open) -> None:
    async with open_page() as user:
        await user.choose("sample")
        await user.draw(BALLOON)
        await user.frames(5)
        await user.pause()
        before = await of(user, 1)
        await user.draw(GREEN)
        await user.until(TWO)
        assert await user.page.get_attribute("#targets li[data-target='2']", "data-chosen") == "true"
        await user.until("document.documentElement.dataset.state === 'tracking'")
        x, y, w, h = GREEN
        await user.drag((x + w, y + h), (x + w + 6, y + h + 6))  # a handle: better, and still target 2
        await user.until("document.getElementById('log').innerText.includes('Target 2 corrected')")
        await user.until("document.querySelector('#targets li[data-target=\"2\"] .where').innerText.endsWith(' 46 62')")
        assert await user.page.locator("#targets li").count() == 2
        assert await of(user, 1) == before, "a frame counts once for the target that was there"


async def test_a_correction_is_undone_and_done_again(open_page: Open, tmp_path: Path) -> None:
    async with open_page() as user:
        await begun(user, tmp_path)
        await user.frames(10)
        await user.pause()
        at, (x, y, w, h) = (await of(user, 1)).popitem()
        await user.drag((x + w / 2, y + h / 2), (x + w / 2 + 40, y + h / 2 + 20))
        await user.until("document.getElementById('log').innerText.includes('corrected')")
        moved = (await of(user, 1))[at]
        assert moved[0] == pytest.approx(x + 40, abs=1.5)
        await user.page.keyboard.press("Control+z")
        assert (await of(user, 1))[at] == pytest.approx((x, y, w, h), abs=0.01)
        await user.page.keyboard.press("Control+Shift+z")
        assert (await of(user, 1))[at] == pytest.approx(moved, abs=0.01)
        await user.page.keyboard.press("Control+z")
        await user.page.click("#play")  # and tracking goes on from there
        await user.end()
        assert sorted(await of(user, 1)) == list(range(COUNT))


async def test_a_target_is_tracked_again_from_where_it_drifted(open_page: Open, tmp_path: Path) -> None:
    """Go back, move the box: what follows is replaced, other targets keep theirs, and undo brings all back."""
    async with open_page() as user:
        await begun(user, tmp_path)
        await user.frames(3)
        await user.pause()
        await user.draw((200, 150, 50, 50))
        await user.until(TWO)
        await user.page.click("#play")
        await user.end()
        before, other = await of(user, 1), await of(user, 2)
        await user.page.keyboard.press("1")
        await user.go_to(20)
        x, y, w, h = before[20]
        await user.drag((x + w / 2, y + h / 2), (x + w / 2 - 15, y + h / 2))
        await user.until("document.getElementById('log').innerText.includes('Target 1 corrected')")
        after = await of(user, 1)
        assert sorted(after) == list(range(21))
        assert after[20][0] == pytest.approx(x - 15, abs=1.5)
        await user.page.click("#play")
        await user.end()
        again = await of(user, 1)
        assert sorted(again) == list(range(COUNT))
        assert {frame: again[frame] for frame in range(20)} == {frame: before[frame] for frame in range(20)}
        assert await of(user, 2) == other
        await user.page.keyboard.press("Control+z")
        assert await of(user, 1) == before


async def test_runs_stay_in_the_list(open_page: Open, tmp_path: Path) -> None:
    async with open_page() as user:
        await begun(user, tmp_path)
        await user.frames(10)
        await user.page.click("#stop")
        await user.draw((150, 120, 60, 60))  # a second run
        await user.frames(5)
        await user.page.click("#change-source")
        await user.choose("sample")
        assert await user.page.locator("#runs li").count() == 2
        await user.page.click("#runs li[data-run='1'] .pick")  # its film is opened again
        await user.until("document.getElementById('clock').innerText.includes('/ 0:02.4')")
        assert len((await user.boxes())["frames"]) >= 10
        await user.page.click("#runs li[data-run='1'] [data-part=remove]")
        assert await user.page.locator("#runs li").count() == 1
        await user.page.keyboard.press("Control+z")
        assert await user.page.locator("#runs li").count() == 2


async def test_leaving_with_boxes_that_were_not_exported_asks(open_page: Open) -> None:
    async with open_page() as user:
        asked: list[str] = []

        async def stay(dialog: object) -> None:
            asked.append(dialog.type)  # type: ignore[attr-defined]
            await dialog.dismiss()  # type: ignore[attr-defined]

        await user.follow_sample(5)
        user.page.on("dialog", stay)
        await user.page.close(run_before_unload=True)
        await user.page.wait_for_timeout(500)
        assert asked == ["beforeunload"]
        await user.pause()
        await user.boxes()
        user.page.remove_listener("dialog", stay)
        assert not await user.page.evaluate("!window.dispatchEvent(new Event('beforeunload', {cancelable: true}))")


async def test_the_api_opens_beside_the_page(open_page: Open) -> None:
    async with open_page() as user:
        assert await user.page.get_attribute(".bar-end a", "target") == "_blank"


async def test_the_list_is_that_of_the_picture_after_a_correction_in_pause(open_page: Open) -> None:
    async with open_page() as user:
        await user.follow_sample(5)
        await user.pause()
        x, y, w, h = (await of(user, 1)).popitem()[1]
        await user.drag((x + w / 2, y + h / 2), (x + w / 2 - 60, y + h / 2 + 30))
        place = f"{round(x - 60)} {round(y + 30)} {round(w)} {round(h)}"
        shown = "document.querySelector('#targets .where').innerText.split(' ').map(Number)"
        wanted = [int(value) for value in place.split()]
        await user.until(f"{shown}.every((value, i) => Math.abs(value - {wanted}[i]) <= 2)")


async def test_a_recording_is_kept_when_the_source_changes(open_page: Open) -> None:
    async with open_page() as user:
        await user.follow_sample(3)
        await user.page.click("#record")
        await user.frames(20)
        async with user.page.expect_download() as saved:
            await user.page.click("#change-source")
        assert (await saved.value).suggested_filename.startswith("mfcmt-sample-clip-")
        assert not await user.page.is_visible("#recording")


async def test_an_exported_run_is_imported_and_compared(open_page: Open, tmp_path: Path) -> None:
    """The same boxes again: every frame agrees with the run that they are from."""
    async with open_page() as user:
        await begun(user, tmp_path)
        await user.end()
        exported = await user.export("json")
        (tmp_path / "run.json").write_bytes(exported.read_bytes())
        await user.page.set_input_files("#import-file", tmp_path / "run.json")
        await user.until("document.querySelectorAll('#runs li').length === 2")
        again = await user.boxes()
        first = await user.page.evaluate("document.querySelectorAll('#runs li')[1].dataset.chosen")
        assert first == "true"
        assert [f["targets"][0]["box"] for f in again["frames"]] == [
            f["targets"][0]["box"] for f in json.loads((tmp_path / "run.json").read_text())["frames"]
        ]
        await user.page.click("#runs li[data-run='1'] [data-part=compare]")
        says = f"overlap 1.00, above half in 100 % of {COUNT} boxes"
        await user.until(f"document.getElementById('runs').innerText.includes('{says}')")
        (tmp_path / "wrong.json").write_text('{"form": "another"}')
        await user.page.set_input_files("#import-file", tmp_path / "wrong.json")
        await user.until("document.getElementById('notice').innerText.includes('cannot be imported')")
        assert await user.page.locator("#runs li").count() == 2


async def test_a_run_is_compared_with_a_truth_file_over_each_other_and_side_by_side(
    open_page: Open, tmp_path: Path, artefacts: Path
) -> None:
    """The success curve is that of `mfcmt eval`; the truth leaves one frame out, as OTB does."""
    x, y, w, h = BOX
    truth = [(x + frame % 120, y, w, h) for frame in range(COUNT)]
    lines = [f"{left + 1},{top + 1},{w},{h}" for left, top, w, h in truth]
    lines[7] = "NaN,NaN,NaN,NaN"
    (tmp_path / "truth.txt").write_text("\n".join(lines))
    async with open_page() as user:
        await begun(user, tmp_path)
        await user.end()
        ours = await of(user, 1)
        await user.page.set_input_files("#import-file", tmp_path / "truth.txt")
        await user.until("document.querySelectorAll('#runs li').length === 2")
        assert "2 truth.txt" in await user.page.inner_text("#runs")
        await user.page.click("#runs li[data-run='1'] [data-part=compare]")
        known = [frame for frame in range(COUNT) if frame != 7]
        overlaps = np.array([iou(ours[frame], truth[frame]) for frame in known])
        says = (
            f"success {success_curve(overlaps).mean():.3f} (area under the curve), mean overlap {overlaps.mean():.3f}"
        )
        await user.until(f"document.getElementById('success-text').innerText === '{says}'")
        assert not await user.page.is_visible("#beside")
        await user.page.click("#apart")
        await user.until("!document.getElementById('beside').hidden")
        places = "['stage', 'beside'].map((id) => document.getElementById(id).getBoundingClientRect().width)"
        stage, beside = await user.page.evaluate(places)
        assert stage == pytest.approx(beside, rel=0.02)
        await user.page.screenshot(path=artefacts / "side-by-side.png")
        assert await violations(user) == []
        await user.page.click("#apart")
        await user.until("document.getElementById('beside').hidden")


async def test_a_video_is_rendered_from_the_results(open_page: Open, tmp_path: Path) -> None:
    async with open_page() as user:
        await begun(user, tmp_path)
        await user.end()
        await user.page.click("#open-export")
        async with user.page.expect_download() as saved:
            await user.page.click("#render")
        made = tmp_path / (await saved.value).suggested_filename
        await (await saved.value).save_as(made)
        assert len(times_of(made)) == COUNT
        assert times_of(made) == pytest.approx(even(COUNT, 25), abs=2e-3)


async def test_the_code_is_that_of_the_run_and_runs(open_page: Open, tmp_path: Path) -> None:
    async with open_page() as user:
        await begun(user, tmp_path)
        await user.frames(3)
        await user.pause()
        await user.page.click("#open-export")
        await user.page.click("#open-code")
        kinds = {"curl": "-F boxes='[[", "python": '"film.mp4"', "javascript": "createSession", "result": '"status"'}
        code = {}
        for kind, says in kinds.items():
            await user.page.select_option("#code-kind", kind)
            code[kind] = await user.page.input_value("#code")
            assert says in code[kind]
        await user.page.click("#code-dialog .primary")
        await runs_in_the_page(user, code["javascript"], tmp_path)
    await runs_in_a_shell(code["curl"], tmp_path)
    await runs_in_python(code["python"], tmp_path)


async def runs_in_the_page(user: Tracker, code: str, folder: Path) -> None:
    """As a module of the page: it follows the film beside it."""
    said: list[str] = []
    user.page.on("console", lambda message: said.append(message.text))
    await user.page.route("**/code.js", lambda route: route.fulfill(body=code, content_type="text/javascript"))
    await user.page.route("**/film.mp4", lambda route: route.fulfill(path=folder / "film.mp4"))
    script = "Object.assign(document.createElement('script'), {type: 'module', src: './code.js'})"
    await user.page.evaluate(f"document.head.append({script})")
    async with asyncio.timeout(60):
        while len(said) < 3:
            await user.page.wait_for_event("console")


async def runs_in_a_shell(code: str, folder: Path) -> None:
    """With the two frames that it names; it ends with the lines of both in the trajectory."""
    require(shutil.which("curl"), "no curl is installed")
    for number, name in enumerate(("frame.jpg", "next.jpg")):
        cv2.imwrite(str(folder / name), picture(number)[:, :, ::-1])
    said = await output("bash", "-e", "-c", code, cwd=folder)
    *_, first, second = (line for line in said.splitlines() if re.match(r"\d+,", line))
    assert (first.split(",")[0], second.split(",")[0]) == ("0", "1")


async def runs_in_python(code: str, folder: Path) -> None:
    """Beside the film: a line for each frame after the first."""
    (folder / "code.py").write_text(code)
    said = await output(sys.executable, "code.py", cwd=folder)
    assert [int(line.split()[0]) for line in said.splitlines()] == list(range(1, COUNT))


async def output(*command: str, cwd: Path) -> str:
    """What a program prints that must succeed."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(*command, stdout=pipe, stderr=pipe, cwd=cwd)
    said, complained = await process.communicate()
    assert process.returncode == 0, complained.decode()
    return said.decode()


async def test_a_link_opens_a_source_with_its_box(open_page: Open) -> None:
    async with open_page() as user:
        await user.page.goto(f"{user.url}/?src=static/page/sample.webm&box=278,184,84,112")
        await user.frames(5)
        first = (await user.boxes())["frames"][0]["targets"][0]["box"]
        assert first == pytest.approx(BALLOON, abs=0.01)


async def test_no_frame_is_left_out_by_a_target_that_is_added_at_once(open_page: Open, tmp_path: Path) -> None:
    """While answers are due, and while the session of both is being started."""
    async with open_page() as user:
        await begun(user, tmp_path)
        await user.page.wait_for_selector("#targets li")
        await user.page.click("#play")
        await user.draw((200, 150, 50, 50))
        await user.until(TWO)
        await user.page.click("#play")
        await user.end()
        assert sorted(await of(user, 1)) == list(range(COUNT))


async def test_a_target_is_tracked_between_two_boxes_from_both_ends(open_page: Open, tmp_path: Path) -> None:
    """Near each box the way is that which was tracked from it; nothing else changes, and undo brings all back."""
    async with open_page() as user:
        await begun(user, tmp_path)
        await user.end()
        before = await of(user, 1)
        assert await user.page.is_disabled("#join"), "there is one box only"
        await user.go_to(40)
        x, y, w, h = before[40]
        await user.drag((x + w / 2, y + h / 2), (x + w / 2 - 15, y + h / 2))
        await user.until("document.getElementById('log').innerText.includes('Target 1 corrected')")
        corrected = await of(user, 1)
        await user.page.click("#join")
        await user.until("document.getElementById('log').innerText.includes('and joined')")
        joined = await of(user, 1)
        assert sorted(joined) == list(range(41))
        assert {frame: joined[frame] for frame in (0, 40)} == {frame: corrected[frame] for frame in (0, 40)}
        assert joined[1][0] == pytest.approx(before[1][0], abs=2)
        assert joined[39][0] == pytest.approx(corrected[40][0] - 1, abs=2)
        assert joined[39][0] < before[39][0] - 8
        await user.page.keyboard.press("Control+z")
        assert await of(user, 1) == corrected
        await user.page.keyboard.press("Control+Shift+z")
        assert await of(user, 1) == joined
        await user.page.click("#play")
        await user.end()
        assert sorted(await of(user, 1)) == list(range(COUNT))


@dataclass
class Way:
    """What `join` reads of a result."""

    box: tuple[float, ...]
    confidence: float


async def test_ways_are_joined_as_the_library_joins_them(open_page: Open) -> None:
    random = np.random.default_rng(3)
    count = 40
    ahead, back = random.uniform(0.2, 0.3, (2, count, 4))
    ahead[15:, 0] += 0.4  # they part, and meet nowhere again
    sure = random.uniform(0, 1, (2, count))
    shares = (np.arange(count) + 1) / (count + 1)
    ways = [
        [Way(tuple(box), value) for box, value in zip(*one, strict=True)] for one in ((ahead, sure[0]), (back, sure[1]))
    ]
    wanted = [(*result.box, result.confidence) for result, _ in join(*ways, shares)]  # type: ignore[arg-type]
    rows = [[{"box": way.box, "confidence": way.confidence} for way in one] for one in ways]
    code = f"import('./static/page/join.js').then(({{join}}) => join(...{json.dumps(rows)}, {shares.tolist()}))"
    async with open_page() as user:
        found = await user.page.evaluate(code)
    assert np.array([(*row["box"], row["confidence"]) for row in found]) == pytest.approx(np.array(wanted))
