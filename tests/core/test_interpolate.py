"""Boxes between keyframes: a result for every frame, from the nearer and more credible side."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest

from mfcmt_core import MFCMT, BadBox, TrackResult, interpolate, synthetic
from mfcmt_core.interpolate import join
from mfcmt_core.otb.metrics import overlap
from tests.commands import run_command

LENGTH = 25


@pytest.fixture(scope="module")
def clip() -> synthetic.Clip:
    return synthetic.clip("motion", target=(56, 44), length=LENGTH)


def result(x: float, confidence: float) -> TrackResult:
    return TrackResult((x, 10.0, 20.0, 20.0), "tracking", None, None, None, None, False, 1.0, confidence)


def test_every_frame_has_a_box_that_names_its_keyframe(clip):
    known = {n: clip.boxes[n] for n in (4, 14, 20)}
    found = list(interpolate.interpolate(clip.frames, known))
    assert [f.frame for f in found] == list(range(LENGTH))
    for n, box in known.items():
        assert (found[n].result.box, found[n].result.confidence, found[n].keyframe) == (tuple(box), 1.0, n)
    assert {f.keyframe for f in found[:4]} == {4}  # tracked backward
    assert {f.keyframe for f in found[20:]} == {20}  # tracked forward
    assert [f.keyframe for f in found[5:14]] == sorted(f.keyframe for f in found[5:14])
    assert {f.keyframe for f in found[5:14]} == {4, 14}
    assert overlap(np.array([f.result.box for f in found]), np.array(clip.boxes)).min() > 0.8


def test_one_keyframe_is_plain_tracking(clip):
    found = [f.result for f in interpolate.interpolate(clip.frames, {0: clip.boxes[0]})]
    assert found == list(MFCMT().track(clip.frames, clip.boxes[0]))


def test_frames_beyond_the_memory_go_to_a_file_and_change_nothing(clip, monkeypatch):
    known = {0: clip.boxes[0], 20: clip.boxes[20]}
    want = list(interpolate.interpolate(clip.frames, known))
    monkeypatch.setattr("mfcmt_core.interpolate.KEPT_BYTES", 3 * clip.frames[0].nbytes)
    assert list(interpolate.interpolate(clip.frames, known)) == want


def test_where_both_ways_agree_their_mean_is_taken_and_where_not_the_credible_one():
    shares = np.array([0.25, 0.5, 0.75])
    ahead = [result(100, 0.9), result(104, 0.9), result(300, 0.2)]
    back = [result(20, 0.1), result(106, 0.9), result(110, 0.9)]
    joined = join(ahead, back, shares)
    assert joined[0][0].box[0] == 100
    assert joined[1][0].box[0] == pytest.approx(105)
    assert joined[2][0].box[0] == 110
    assert [side for _, side in joined][::2] == [0, 1]


def test_what_cannot_be_used_is_named(clip):
    with pytest.raises(ValueError, match="no keyframe"):
        list(interpolate.interpolate(clip.frames, {}))
    with pytest.raises(ValueError, match="the keyframe 99 has no frame"):
        list(interpolate.interpolate(clip.frames, {0: clip.boxes[0], 99: clip.boxes[0]}))
    with pytest.raises(BadBox, match="keyframe 3: "):
        list(interpolate.interpolate(clip.frames, {3: (9000, 0, 20, 20)}))


def test_the_command_fills_in_several_targets(clip, tmp_path):
    import cv2

    for n, frame in enumerate(clip.frames):
        cv2.imwrite(str(tmp_path / f"{n}.png"), frame)
    known = [(n, "plate") for n in (0, 12, 24)] + [(6, "other")]
    lines = ["frame,name,x,y,w,h"] + [f"{n},{name},{','.join(map(str, clip.boxes[n]))}" for n, name in known]
    (tmp_path / "k.csv").write_text("\n".join(lines))
    done = run_command("track", tmp_path, "--keyframes", tmp_path / "k.csv", "--video", tmp_path / "seen.mp4")
    assert (done.returncode, done.stderr) == (0, "")
    rows = list(csv.DictReader(io.StringIO(done.stdout)))
    plate = [r for r in rows if r["target"] == "plate"]
    assert [int(r["frame"]) for r in plate] == list(range(LENGTH))
    want = list(interpolate.interpolate(clip.frames, {n: clip.boxes[n] for n in (0, 12, 24)}))
    assert [int(r["keyframe"]) for r in plate] == [f.keyframe for f in want]
    assert [float(r["x"]) for r in plate] == pytest.approx([f.result.box[0] for f in want])
    assert len([r for r in rows if r["target"] == "other"]) == LENGTH
    assert (tmp_path / "seen.mp4").stat().st_size > 1000
    (tmp_path / "k.csv").write_text("frame,x,y,w,h\n0,129,80,56,44\n99,129,80,56,44\n")
    done = run_command("track", tmp_path, "--keyframes", tmp_path / "k.csv")
    assert (done.returncode, "no such frame for these keyframes: target, frame 99" in done.stderr) == (1, True)
    assert len(done.stdout.splitlines()) == 1 + LENGTH
