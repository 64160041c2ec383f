"""Exports say what was tracked, as the tools that read them understand it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import motmetrics
import numpy as np
import pytest
from pycocotools.coco import COCO

from mfcmt_core import TrackResult
from mfcmt_core.exports import Clip, Options, Row, Target, open_writer
from mfcmt_core.exports.thin import keyframes
from mfcmt_core.result import Box, Status

CLIP = Clip("a & b.mp4", 320, 240, 25.0)
LENGTH = 60
CAR, BIRD = Target(1, 'car "1"', "car"), Target(2, "bird", "bird")
LOST = range(30, 36)
"""Frames in which the car is lost."""


def box_of(target: Target, frame: int) -> Box:
    """Return a path with bends; the bird leaves the frame on the right."""
    if target is CAR:
        return (20 + 3 * frame - 2.5 * max(0, frame - 20), 50 + 8 * np.sin(frame / 9), 40 + 0.2 * frame, 30)
    return (100 + 8 * frame, 100.0, 30.0, 20.0)


def rows() -> list[list[Row]]:
    """Return the rows of each frame: the bird begins at frame 10."""
    made = []
    for frame in range(LENGTH):
        of_frame = []
        for target in (CAR, BIRD)[: 1 + (frame >= 10)]:
            status: Status = "lost" if target is CAR and frame in LOST else "tracking"
            box = tuple(map(float, box_of(target, frame)))
            result = TrackResult(box, status, None, None, None, None, False, 1.0, 0.875)  # type: ignore[arg-type]
            of_frame.append(Row(frame, frame / 25, target, result))
        made.append(of_frame)
    return made


def exported(style: str, path: Path, tolerance: float = 1.5, clip: Clip = CLIP) -> Path:
    writer = open_writer(Options(style, path, tolerance), clip)
    for of_frame in rows():
        writer.write(of_frame)
    writer.close(LENGTH)
    return path


def visible(target: Target, frame: int) -> np.ndarray | None:
    """Return the edges of the part of the box in the frame: left, top, right, bottom."""
    if (target is CAR and frame in LOST) or (target is BIRD and frame < 10):
        return None
    x, y, w, h = box_of(target, frame)
    left, top, right, bottom = max(x, 0), max(y, 0), min(x + w, 320), min(y + h, 240)
    return np.array([left, top, right, bottom]) if right > left else None


def assert_path(target: Target, points: dict[int, tuple[np.ndarray, bool]], tolerance: float) -> None:
    """Assert that lines between keyframes are the path. ``points`` are edges and whether the box goes on, by frame."""
    frames = sorted(points)
    for frame in range(LENGTH):
        before = [f for f in frames if f <= frame]
        after = [f for f in frames if f > frame]
        drawn = None
        if before and (points[before[-1]][1] or before[-1] == frame):
            drawn = points[before[-1]][0]
            if after and points[before[-1]][1]:
                share = (frame - before[-1]) / (after[0] - before[-1])
                drawn = drawn + share * (points[after[0]][0] - drawn)
        wanted = visible(target, frame)
        assert (drawn is None) == (wanted is None), (target.name, frame)
        if wanted is not None:
            assert drawn == pytest.approx(wanted, abs=tolerance + 0.02), (target.name, frame)


def test_coco_is_read_by_its_own_tools(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    read = COCO(str(exported("coco", tmp_path / "a.json")))
    capsys.readouterr()
    assert [read.cats[n]["name"] for n in read.getCatIds()] == ["car", "bird"]
    assert len(read.getImgIds()) == LENGTH
    for frame in range(LENGTH):
        found = {a["track_id"]: a for a in read.loadAnns(read.getAnnIds(imgIds=[frame + 1]))}
        for target in (CAR, BIRD):
            wanted = visible(target, frame)
            assert (wanted is None) == (target.id not in found)
            if wanted is not None:
                x, y, w, h = found[target.id]["bbox"]
                assert [x, y, x + w, y + h] == pytest.approx(wanted, abs=2e-3)
                assert found[target.id]["instance_id"] == target.id
    document = json.loads((tmp_path / "a.json").read_text())
    assert [t["name"] for t in document["tracks"]] == [CAR.name, BIRD.name]
    assert document["images"][3] | {"time_s": 0.12, "file_name": "a & b_000003.jpg"} == document["images"][3]


def test_mot_is_read_by_motmetrics(tmp_path: Path) -> None:
    read = motmetrics.io.loadtxt(str(exported("mot", tmp_path / "a.txt")), fmt="mot15-2D")
    car = read.xs(CAR.id, level="Id")
    assert list(car.index) == [f + 1 for f in range(LENGTH) if f not in LOST]
    got = car[["X", "Y", "Width", "Height"]].to_numpy()
    wanted = np.array([box_of(CAR, f - 1) for f in car.index])
    assert got == pytest.approx(wanted, abs=2e-3)  # their reader brings pixels from 1 to 0
    assert (car["Confidence"] == 0.875).all()


@pytest.mark.parametrize("tolerance", [0.0, 1.5, 6.0])
def test_cvat_draws_the_path_between_keyframes(tolerance: float, tmp_path: Path) -> None:
    root = ET.fromstring(exported("cvat", tmp_path / "a.xml", tolerance).read_bytes())
    assert root.findtext("version") == "1.1"
    assert root.findtext("meta/task/size") == str(LENGTH)
    assert [e.text for e in root.findall("meta/task/labels/label/name")] == ["car", "bird"]
    for target, track in zip((CAR, BIRD), root.findall("track"), strict=True):
        points = {}
        for box in track.findall("box"):
            assert (box.get("keyframe"), box.findtext("attribute")) == ("1", target.name)
            edges = np.array([float(box.get(key, "")) for key in ("xtl", "ytl", "xbr", "ybr")])
            points[int(box.get("frame", ""))] = (edges, box.get("outside") == "0")
        shown = {f: p for f, p in points.items() if p[1]}
        away = {f: (p[0], False) for f, p in points.items() if not p[1]}
        assert_cvat(target, shown | away, tolerance)
        assert len(points) < LENGTH or tolerance == 0


def assert_cvat(target: Target, points: dict[int, tuple[np.ndarray, bool]], tolerance: float) -> None:
    """Assert the path as CVAT draws it: a box stays where it was until the frame in which it is outside."""
    frames = sorted(points)
    for frame in range(LENGTH):
        before = max((f for f in frames if f <= frame), default=None)
        wanted = visible(target, frame)
        if before is None or not points[before][1]:
            assert wanted is None, (target.name, frame)
            continue
        after = min((f for f in frames if f > frame and points[f][1]), default=None)
        nearest = min((f for f in frames if f > frame), default=None)
        drawn = points[before][0]
        if after is not None and after == nearest:
            drawn = drawn + (frame - before) / (after - before) * (points[after][0] - drawn)
        assert wanted is not None, (target.name, frame)
        assert drawn == pytest.approx(wanted, abs=tolerance + 0.02), (target.name, frame)


@pytest.mark.parametrize("tolerance", [0.0, 1.5, 6.0])
def test_label_studio_draws_the_path_between_keyframes(tolerance: float, tmp_path: Path) -> None:
    (task,) = json.loads(exported("labelstudio", tmp_path / "a.json", tolerance).read_text())
    assert task["data"] == {"video": CLIP.name}
    for target, region in zip((CAR, BIRD), task["predictions"][0]["result"], strict=True):
        value: dict[str, Any] = region["value"]
        assert (region["type"], region["from_name"], region["to_name"]) == ("videorectangle", "box", "video")
        assert (value["labels"], value["framesCount"], value["duration"]) == ([target.kind], LENGTH, LENGTH / 25)
        points = {}
        for point in value["sequence"]:
            x, y = point["x"] * 3.2, point["y"] * 2.4
            edges = np.array([x, y, x + point["width"] * 3.2, y + point["height"] * 2.4])
            points[point["frame"] - 1] = (edges, point["enabled"])
            assert point["time"] == pytest.approx((point["frame"] - 1) / 25)
        assert_path(target, points, tolerance)


def test_yolo_has_a_file_a_frame(tmp_path: Path) -> None:
    folder = exported("yolo", tmp_path / "out")
    files = sorted((folder / "labels").iterdir())
    assert [f.name for f in files] == [f"a & b_{frame:06}.txt" for frame in range(LENGTH)]
    for frame, file in enumerate(files):
        found = {int(line.split()[0]): np.array(line.split()[1:], float) for line in file.read_text().splitlines()}
        for kind, target in enumerate((CAR, BIRD)):
            wanted = visible(target, frame)
            assert (wanted is None) == (kind not in found)
            if wanted is not None:
                x, y, w, h = found[kind] * [320, 240, 320, 240]
                assert [x - w / 2, y - h / 2, x + w / 2, y + h / 2] == pytest.approx(wanted, abs=1e-3)
    assert '0: "car"\n  1: "bird"' in (folder / "data.yaml").read_text()
    images = Clip("frames", 320, 240, 30.0, tuple(f"img{n}.png" for n in range(LENGTH)))
    exported("yolo", tmp_path / "named", clip=images)
    assert (tmp_path / "named" / "labels" / "img7.txt").is_file()


def test_rows_are_on_disk_as_soon_as_they_are_written(tmp_path: Path) -> None:
    writer = open_writer(Options("csv", tmp_path / "a.csv"), CLIP)
    for number, of_frame in enumerate(rows()[:10], 1):
        writer.write(of_frame)
        assert len((tmp_path / "a.csv").read_text().splitlines()) == 1 + number


def test_thinning_keeps_each_edge_within_the_tolerance() -> None:
    frames = np.arange(0, 200, 2)
    generator = np.random.default_rng(1)
    boxes = np.column_stack([np.cumsum(generator.normal(size=(100, 2)), axis=0), 30 + generator.random((100, 2))])
    counts = []
    for tolerance in (0.0, 1.0, 4.0, 1e6):
        kept = keyframes(frames, boxes, tolerance)
        assert (kept[0], kept[-1]) == (0, 99)
        edges = np.column_stack([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]])
        for edge in edges.T:
            assert np.abs(np.interp(frames, frames[kept], edge[kept]) - edge).max() <= tolerance + 1e-9
        counts.append(len(kept))
    assert counts[0] == 100 > counts[1] > counts[2] > counts[3] == 2
    assert keyframes([5], boxes[:1], 1.0) == [0]
    assert keyframes([], np.empty((0, 4)), 1.0) == []
