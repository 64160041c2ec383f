"""Boxes between keyframes, measured against lines and against tracking forward alone."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from mfcmt_core import MFCMTConfig, synthetic
from mfcmt_core.otb.between import WAYS, between_keyframes, between_table, keyframes
from mfcmt_core.otb.dataset import Dataset, Sequence
from tests.commands import run_command


def sequence(folder: Path, length: int = 31) -> Sequence:
    """Write a clip with its truth, which is away in two frames."""
    clip = synthetic.clip("motion", target=(56, 44), length=length)
    (folder / "img").mkdir(parents=True)
    for n, frame in enumerate(clip.frames):
        cv2.imwrite(str(folder / "img" / f"{n}.png"), frame)
    boxes = np.array(clip.boxes, float)
    boxes[10:12] = np.nan
    (folder / "groundtruth.txt").write_text("\n".join(",".join(map(str, b + np.array([1, 1, 0, 0]))) for b in boxes))
    return Sequence.of("clip", sorted((folder / "img").iterdir(), key=lambda p: int(p.stem)), boxes)


def test_keyframes_lie_where_the_truth_is_known(tmp_path: Path) -> None:
    assert keyframes(sequence(tmp_path), 10) == [0, 12, 22]


def test_each_way_is_scored_on_the_frames_between(tmp_path: Path) -> None:
    clip = sequence(tmp_path)
    told: list[tuple[int, int]] = []
    scores = between_keyframes(
        Dataset("one", {"clip": clip}), [10, 100], MFCMTConfig.default(), 1, lambda *done: told.append(done)
    )
    assert told == [(1, 2), (2, 2)]
    assert set(scores[10]) == set(WAYS)
    assert {len(overlaps) for ways in scores[10].values() for overlaps in ways} == {23 - 3 - 2}
    means = {way: overlaps[0].mean() for way, overlaps in scores[10].items()}
    assert means["tracked from both ends"] > 0.9 > 0.8 > means["lines between them"]
    assert scores[100] == {way: [] for way in WAYS}  # no second keyframe
    assert [row[:2] for row in between_table(scores).rows] == [["10", way] for way in WAYS]


def test_the_command_prints_the_table(tmp_path: Path) -> None:
    sequence(tmp_path / "data" / "clip")
    done = run_command("eval", "--data", tmp_path / "data", "--keyframes", "10", "--jobs", "1")
    assert (done.returncode, done.stderr) == (0, "")
    assert "| 10 | tracked from both ends |" in done.stdout
    done = run_command("eval", "--data", tmp_path / "data", "--keyframes", "1")
    assert (done.returncode, "numbers of frames from 2 on" in done.stderr) == (2, True)
