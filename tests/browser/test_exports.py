"""The page's exports are those of ``mfcmt track``: the same bytes from the same rows."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from mfcmt_core.exports import Clip, Options, Row, Target, open_writer
from mfcmt_core.result import Flags, Scores, TrackResult

from .conftest import Open, loop
from .driver import Tracker
from .films import BOX, even, film

pytestmark = loop
COUNT = 40


def result(row: dict[str, Any]) -> TrackResult:
    """The tracker's own result that a row of our JSON tells."""
    known = {field.name for field in fields(TrackResult)}
    values = {name: value for name, value in row.items() if name in known}
    values["box"] = tuple(row["box"])
    values["flags"] = Flags(**row["flags"]) if row.get("flags") else None
    values["scores"] = Scores(**row["scores"]) if row.get("scores") else None
    return TrackResult(**values)


def ours(exported: dict[str, Any], kind: str, folder: Path) -> Path:
    """What ``mfcmt track`` would write of the same rows."""
    about = exported["about"]
    clip = Clip(exported["source"], *about["size"], about["fps"])
    targets = {one["id"]: Target(one["id"], one["name"], one["class"]) for one in exported["targets"]}
    path = folder / f"ours-{kind}"
    writer = open_writer(Options(kind, path), clip)
    for frame in exported["frames"]:
        rows = [Row(frame["frame"], frame["time_s"], targets[one["target"]], result(one)) for one in frame["targets"]]
        writer.write(rows)
    writer.close(about["frames"])
    return path


async def two_targets(user: Tracker, folder: Path) -> dict[str, Any]:
    film(folder / "film.mp4", even(COUNT, 25))
    await user.set("maxSide", "0")
    await user.open_file(folder / "film.mp4")
    await user.draw(BOX)
    await user.frames(5)
    await user.pause()
    await user.draw((210, 150, 60, 50))
    await user.until("document.querySelectorAll('#targets li').length === 2")
    await user.page.click("#targets li[data-target='2'] [data-does=name]")
    await user.page.fill("#name", "the <left> one")
    await user.page.fill("#kind", "balloon")
    await user.page.click("#name-dialog .primary")
    await user.page.focus("#stage")
    await user.page.keyboard.press("Space")
    await user.end()
    return await user.boxes()


@pytest.mark.parametrize("kind", ["csv", "mot", "coco", "cvat"])
async def test_the_export_has_the_bytes_of_the_command(open_page: Open, tmp_path: Path, kind: str) -> None:
    async with open_page() as user:
        exported = await two_targets(user, tmp_path)
        assert [one["name"] for one in exported["targets"]] == ["1", "the <left> one"]
        text = (await user.export(kind)).read_text()
    wanted = ours(exported, kind, tmp_path).read_text()
    if kind == "coco":
        assert json.loads(text) == json.loads(wanted)
    else:
        assert text == wanted


async def test_yolo_and_otb_have_the_lines_of_the_command(open_page: Open, tmp_path: Path) -> None:
    async with open_page() as user:
        exported = await two_targets(user, tmp_path)
        packed = (await user.export("yolo")).read_bytes()
        await user.page.keyboard.press("1")
        otb = (await user.export("otb")).read_text()
    folder = ours(exported, "yolo", tmp_path)
    with zipfile.ZipFile(io.BytesIO(packed)) as files:
        names = {name for name in files.namelist() if name.startswith("labels/")}
        assert names == {f"labels/{path.name}" for path in (folder / "labels").iterdir()}
        for name in names:
            assert files.read(name).decode() == (folder / name).read_text()
    assert len(otb.splitlines()) == COUNT
    boxes = [frame["targets"][0]["box"] for frame in exported["frames"]]
    assert otb.splitlines() == [f"{x + 1:.3f},{y + 1:.3f},{w:.3f},{h:.3f}" for x, y, w, h in boxes]
