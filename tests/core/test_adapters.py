"""Each adapter says what the tracker itself says, in its toolkit's words."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from PIL import Image

from mfcmt_core import MFCMT, BadBox, BadImage, MFCMTConfig, NotInitialised, TrackResult, adapters, synthetic


@pytest.fixture(scope="module")
def clip() -> synthetic.Clip:
    return synthetic.clip("motion", length=120)


@pytest.fixture(scope="module")
def truth(clip) -> list[TrackResult]:
    return list(MFCMT().track(clip.frames[:12], clip.boxes[0]))


def test_the_opencv_adapter_gives_the_library_s_boxes(clip, truth):
    tracker = adapters.OpenCVTracker.create(MFCMTConfig.default())
    with pytest.raises(NotInitialised):
        tracker.update(clip.frames[0])
    assert tracker.init(clip.frames[0], tuple(clip.boxes[0])) is None
    for i in range(1, 12):
        ok, box = tracker.update(clip.frames[i])
        assert ok is True
        assert box == truth[i].box
    with pytest.raises(BadBox):
        tracker.init(clip.frames[0], (10, 10, 0, 5))


def test_the_opencv_adapter_is_not_ok_while_the_target_is_lost(clip, monkeypatch):
    tracker = adapters.OpenCVTracker()
    tracker.init(clip.frames[0], clip.boxes[0])
    lost = TrackResult((1.0, 2.0, 3.0, 4.0), "lost", False, None, None, 2.0, False, 1.0)
    monkeypatch.setattr(tracker.tracker, "update", lambda image: lost)
    assert tracker.update(clip.frames[1]) == (False, (1.0, 2.0, 3.0, 4.0))


def test_the_got10k_adapter_gives_the_library_s_boxes(clip, truth):
    tracker = adapters.Got10kTracker(name="ours")
    assert (tracker.name, tracker.is_deterministic) == ("ours", True)
    rgb = [Image.fromarray(frame[..., ::-1]) for frame in clip.frames[:12]]
    tracker.init(rgb[0], clip.boxes[0])
    for i in range(1, 12):
        box = tracker.update(rgb[i])
        assert box.shape == (4,)
        assert tuple(box) == truth[i].box


def test_the_got10k_adapter_tracks_image_files(clip, truth, tmp_path):
    short = synthetic.clip("motion", length=120)
    files = []
    for i, frame in enumerate(short.frames[:12]):
        files.append(tmp_path / f"{i}.png")
        cv2.imwrite(str(files[-1]), frame)
    boxes, seconds = adapters.Got10kTracker().track([str(f) for f in files], list(clip.boxes[0]))
    assert boxes.shape == (12, 4)
    assert seconds.shape == (12,)
    assert (seconds > 0).all()
    assert boxes == pytest.approx(np.array([r.box for r in truth]))
    from_one, _ = adapters.Got10kTracker(origin=1).track(files, clip.boxes[0] + (1, 1, 0, 0))
    assert from_one == pytest.approx(boxes + np.array([1, 1, 0, 0]))
    (tmp_path / "3.png").write_bytes(b"not an image")
    with pytest.raises(BadImage, match=r"3\.png"):
        adapters.Got10kTracker().track(files, clip.boxes[0])


@pytest.mark.parametrize("mode", ["L", "P", "RGBA"])
def test_the_got10k_adapter_takes_other_image_modes(clip, mode):
    tracker = adapters.Got10kTracker()
    image = Image.fromarray(clip.frames[0][..., ::-1]).convert(mode)
    tracker.init(image, clip.boxes[0])
    assert np.isfinite(tracker.update(image)).all()


def test_xyxy_is_a_row_of_corners():
    result = TrackResult((10.5, 20.0, 4.0, 8.0), "tracking", None, None, None, None, True, 1.0)
    row = adapters.xyxy(result)
    assert row.dtype == np.float32
    assert row.tolist() == [[10.5, 20.0, 14.5, 28.0]]
