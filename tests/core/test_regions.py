"""Regions: pixels outside what is needed change no bit, and a cut of the frame does as well as the frame."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfcmt_core import MFCMT, MFCMTConfig, RegionTooSmall, synthetic
from mfcmt_core.geometry import Rect

from .helpers import ALERT, PRESETS

SIZE = (320, 240)


def junk(frame, region: Rect, seed):
    """Return the frame with noise outside ``region``."""
    out = np.random.default_rng(seed).integers(0, 256, frame.shape, np.uint8)
    x, y, w, h = region
    out[y : y + h, x : x + w] = frame[y : y + h, x : x + w]
    return out


def cut(frame, region: Rect):
    """Return the arguments of a call with this region of the frame."""
    x, y, w, h = region
    size = frame.shape[1], frame.shape[0]
    return {"image": frame[y : y + h, x : x + w].copy(), "offset": (x, y), "frame_size": size}


def starting_region(config, frame, box) -> Rect:
    """Return the region that a start on ``box`` needs, from the refusal of a smaller one."""
    x, y = (int(np.clip(v, 0, s - 1)) for v, s in zip(box[:2], (frame.shape[1], frame.shape[0]), strict=True))
    with pytest.raises(RegionTooSmall) as caught:
        MFCMT(config).init(box=box, **cut(frame, (x, y, 1, 1)))
    return caught.value.needed


def compare(config, frames, box, starts=()):
    """Assert that whole frames, noise outside the region, and regions give results equal to the last bit."""
    whole, noisy, narrow, roomy = (MFCMT(config) for _ in range(4))
    statuses = []
    for index, frame in enumerate(frames):
        begin = dict(starts).get(index, box if index == 0 else None)
        if begin is not None:
            region = starting_region(config, frame, begin)
            expected = whole.init(frame, begin)
            assert noisy.init(junk(frame, region, index), begin) == expected
            assert narrow.init(box=begin, **cut(frame, region)) == expected
            assert roomy.init(frame, begin) == expected
        else:
            region, wide = whole.needed_region(), roomy.region(lag=1)
            assert narrow.needed_region() == region
            expected = whole.update(frame)
            assert noisy.update(junk(frame, region, index)) == expected
            assert narrow.update(**cut(frame, region)) == expected
            assert roomy.update(**cut(frame, wide)) == expected
        statuses.append(expected.status)
    state = whole.to_bytes()
    assert noisy.to_bytes() == narrow.to_bytes() == roomy.to_bytes() == state
    return statuses


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("scene", ["motion", "scale", "grey", "small"])
def test_a_region_gives_the_frame_s_result_while_tracking(scene, preset):
    sequence = synthetic.clip(scene)
    compare(PRESETS[preset], sequence.frames[:45:3], sequence.boxes[0])


@pytest.mark.parametrize("config", [ALERT, MFCMTConfig.paper().replace(lost_after=8)], ids=["alert", "paper"])
def test_a_region_gives_the_frame_s_result_through_lost_and_back(config):
    """The target reaches the border, leaves the frame, is lost, and is found."""
    sequence = synthetic.clip("leaves")
    statuses = compare(config, sequence.frames[38:124], sequence.boxes[38])
    assert "lost" in statuses
    assert statuses[-1] == "tracking"


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("box", [(-20, -15, 56, 44), (290, 210, 56, 44), (0, 0, 320, 240), (-100, -60, 500, 360)])
def test_a_region_gives_the_frame_s_result_at_the_border(box, preset, frames):
    compare(PRESETS[preset], frames[:5], box)


def test_a_region_is_enough_for_scales_larger_than_the_window(frames, clip):
    """The pixels of the largest scale end where the region does."""
    config = MFCMTConfig.default().replace(window="target", search_area_scale=1.2, num_scales=5, scale_step=1.5)
    compare(config, frames[:8], clip.boxes[0])


@pytest.mark.parametrize("preset", PRESETS)
def test_a_region_gives_the_frame_s_result_after_corrections(preset, frames, clip):
    corrections = [(4, (200.0, 100.0, 30.0, 60.0)), (7, (-5.0, 180.0, 40.0, 40.0)), (10, tuple(clip.boxes[10]))]
    compare(PRESETS[preset], frames[:13], clip.boxes[0], corrections)


@settings(max_examples=25)
@given(st.tuples(*[st.integers(0, 320)] * 4), st.integers(0, 2**32 - 1))
def test_any_region_that_covers_the_needed_one_gives_the_same_result(frames, clip, more, seed):
    whole, narrow = MFCMT(), MFCMT()
    for tracker in (whole, narrow):
        tracker.init(frames[0], clip.boxes[0])
    for frame in frames[1:4]:
        x, y, w, h = whole.needed_region()
        x0, y0 = max(x - more[0], 0), max(y - more[1], 0)
        x1, y1 = min(x + w + more[2], SIZE[0]), min(y + h + more[3], SIZE[1])
        noisy = junk(frame, (x, y, w, h), seed)
        assert narrow.update(**cut(noisy, (x0, y0, x1 - x0, y1 - y0))) == whole.update(frame)


def test_a_region_may_be_a_view_of_any_layout(frames, clip):
    whole, narrow = MFCMT(), MFCMT()
    for tracker in (whole, narrow):
        tracker.init(frames[0], clip.boxes[0])
    for frame in frames[1:5]:
        x, y, w, h = whole.needed_region()
        view = np.asfortranarray(frame)[y : y + h, x : x + w]
        assert narrow.update(view, offset=(np.int64(x), y), frame_size=SIZE) == whole.update(frame)
