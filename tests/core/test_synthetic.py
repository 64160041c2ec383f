"""The rendered sequences say exactly where the target is."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfcmt_core import synthetic
from mfcmt_core.synthetic import paint


@pytest.mark.parametrize("name", [n for n in synthetic.SCENES if n != "large"])
def test_each_scene_has_frames_and_boxes(name):
    scene = synthetic.SCENES[name]
    sequence = synthetic.clip(name, length=24)
    width, height = scene.size
    assert len(sequence) == len(sequence.frames) == len(sequence.boxes) == len(sequence.shown) == 24
    for frame in sequence.frames[::6]:
        assert frame.dtype == np.uint8
        assert frame.shape == ((height, width) if scene.gray else (height, width, 3))
        assert frame.flags.c_contiguous
        assert frame.std() > 15
    assert np.isfinite(sequence.boxes).all()
    assert (sequence.boxes[:, 2:] > 0).all()
    assert sequence.boxes[0, 2:] == pytest.approx(scene.target)
    assert ((sequence.shown >= -1e-9) & (sequence.shown <= 1 + 1e-9)).all()
    assert sequence.visible[0]


def test_large_target_in_a_large_frame():
    sequence = synthetic.clip("large", length=2)
    assert sequence.frames[1].shape == (1080, 1920, 3)
    assert sequence.boxes[0, 2:].max() == 1000


def test_frames_follow_from_the_seed_in_any_order():
    one, two = synthetic.clip("sample", length=12), synthetic.clip("sample", length=12)
    forwards = list(one.frames)
    for i in (11, 3, 7, 0):
        assert np.array_equal(two.frames[i], forwards[i])
    assert np.array_equal(one.frames[-1], forwards[11])
    assert np.array_equal(one.boxes, two.boxes)
    other = synthetic.clip("sample", length=12, seed=1)
    assert not np.array_equal(other.frames[3], forwards[3])
    with pytest.raises(IndexError):
        one.frames[12]


@settings(max_examples=60)
@given(st.floats(-12, 60), st.floats(-12, 45), st.floats(8, 40), st.floats(8, 40), st.floats(1, 5))
def test_blend_fills_the_box_to_a_fraction_of_a_pixel(x, y, w, h, detail):
    """A white sprite on black has the box's area as its mass and the box's middle as its centroid."""
    frame = np.zeros((144, 144, 3), np.float32)
    offset = np.array([30.0, 30.0])
    white = np.ones((int(h * detail), int(w * detail), 4), np.float32)
    paint.blend(frame, white, (x + offset[0], y + offset[1], w, h))
    mass = frame[..., 0]
    rows, cols = np.mgrid[0:144, 0:144]
    assert mass.sum() == pytest.approx(w * h, rel=0.01)
    assert (mass * (cols + 0.5)).sum() / mass.sum() == pytest.approx(x + offset[0] + w / 2, abs=0.05)
    assert (mass * (rows + 0.5)).sum() / mass.sum() == pytest.approx(y + offset[1] + h / 2, abs=0.05)


def test_the_target_is_at_its_true_box():
    """At their true boxes two frames show the target more alike than a fifth of a pixel beside them."""
    sequence = synthetic.clip("motion", grain=0.0)

    def cut(i: int, dx: float = 0.0, dy: float = 0.0) -> np.ndarray:
        x, y, w, h = sequence.boxes[i]
        centre = (x + w / 2 - 0.5 + dx, y + h / 2 - 0.5 + dy)
        return cv2.getRectSubPix(sequence.frames[i].astype(np.float32), (48, 36), centre)

    for i in (17, 50, 75, 93):
        here = np.corrcoef(cut(0).ravel(), cut(i).ravel())[0, 1]
        assert here > 0.98
        for beside in ((0.2, 0), (-0.2, 0), (0, 0.2), (0, -0.2)):
            assert np.corrcoef(cut(0).ravel(), cut(i, *beside).ravel())[0, 1] < here


def test_balloon_fills_its_box():
    alpha = paint.balloon(0, 0.3)[..., 3] > 0.5
    rows, cols = np.flatnonzero(alpha.any(axis=1)), np.flatnonzero(alpha.any(axis=0))
    assert rows[0] <= 1
    assert rows[-1] >= alpha.shape[0] - 2
    assert cols[0] <= 1
    assert cols[-1] >= alpha.shape[1] - 2


def test_each_scene_shows_what_its_name_says():
    def area(s: synthetic.Clip) -> np.ndarray:
        return s.boxes[:, 2:].prod(axis=1)

    assert area(synthetic.clip("scale")).max() == pytest.approx(56 * 44 * 1.5**2, rel=0.01)
    assert np.ptp(area(synthetic.clip("motion"))) < 1e-6
    assert 0.3 < synthetic.clip("occlusion").shown.min() < 0.5
    assert synthetic.clip("occlusion", hide=1.1).shown.min() == pytest.approx(0)
    away = synthetic.clip("leaves")
    assert away.shown.min() == 0
    assert away.visible[-1]
    light = [f.mean() for f in synthetic.clip("illumination").frames[::10]]
    assert max(light) > 2 * min(light)
    assert (synthetic.clip("small").boxes[:, 2:] == 8).all()
    assert 0.3 < synthetic.clip("sample").shown.min() < 0.6


def test_a_scene_without_a_visible_target_is_refused():
    with pytest.raises(ValueError, match="no scene 'nosuch'"):
        synthetic.clip("nosuch")
    for changes in ({"length": 0}, {"size": (8, 8)}, {"target": (1, 20)}, {"target": (400, 20)}):
        with pytest.raises(ValueError, match="cannot render"):
            synthetic.clip("motion", **changes)


def test_written_sequence_reads_back(tmp_path):
    sequence = synthetic.clip("motion", length=4)
    sequence.write(tmp_path / "Clip", suffix=".png")
    files = sorted((tmp_path / "Clip" / "img").iterdir())
    assert [f.name for f in files] == ["0001.png", "0002.png", "0003.png", "0004.png"]
    assert np.array_equal(cv2.imread(str(files[2])), sequence.frames[2])
    truth = np.loadtxt(tmp_path / "Clip" / "groundtruth_rect.txt", delimiter=",")
    assert truth - (1, 1, 0, 0) == pytest.approx(sequence.boxes, abs=5e-4)
