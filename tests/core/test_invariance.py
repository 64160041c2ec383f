"""What must not change the tracker's results, or change them in a known way: layouts, shifts, mirrors, choices."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfcmt_core import MFCMT, MFCMTConfig, synthetic
from mfcmt_core.otb.metrics import overlap

from .helpers import PRESETS, boxes_of, track

DEFAULT = MFCMTConfig.default()


LAYOUTS = {
    "fortran": np.asfortranarray,
    "flipped view": lambda image: np.ascontiguousarray(image[::-1, ::-1])[::-1, ::-1],
    "swapped channels": lambda image: np.ascontiguousarray(image[..., ::-1])[..., ::-1],
    "alpha left out": lambda image: np.concatenate([image, image[..., :1]], axis=2)[..., :3],
    "every second pixel": lambda image: np.repeat(np.repeat(image, 2, axis=0), 2, axis=1)[::2, ::2],
    "part of a larger one": lambda image: np.pad(image, ((3, 5), (7, 2), (0, 0)))[3:-5, 7:-2],
    "planes": lambda image: np.moveaxis(np.ascontiguousarray(np.moveaxis(image, 2, 0)), 0, 2),
    "read-only": lambda image: np.frombuffer(image.tobytes(), np.uint8).reshape(image.shape),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_memory_layout_of_the_image_does_not_matter(layout, frames, clip):
    box = clip.boxes[0] + (-120, -90, 0, 0)  # over the border, so that both ways of cutting are used
    expected = [MFCMT(DEFAULT).init(frames[0], box), *MFCMT(DEFAULT).track(frames[:5], box)]
    laid_out = [LAYOUTS[layout](frame) for frame in frames[:5]]
    assert all(np.array_equal(a, b) for a, b in zip(laid_out, frames, strict=False))
    tracker = MFCMT(DEFAULT)
    results = [tracker.init(laid_out[0], box), *MFCMT(DEFAULT).track(laid_out, box)]
    assert results == expected
    inside = list(MFCMT(DEFAULT).track(frames[:5], clip.boxes[0]))
    assert list(MFCMT(DEFAULT).track(laid_out, clip.boxes[0])) == inside


@pytest.mark.parametrize("preset", PRESETS)
def test_gray_frames_may_have_one_channel_or_three(preset):
    """The shape may change from frame to frame."""
    sequence = synthetic.clip("grey", length=60)
    flat = sequence.frames[:12]
    tripled = [np.repeat(frame[..., None], 3, axis=2) for frame in flat]
    expected = track(PRESETS[preset], flat, sequence.boxes[0])
    assert track(PRESETS[preset], tripled, sequence.boxes[0]) == expected
    assert track(PRESETS[preset], [f if i % 2 else t for i, (f, t) in enumerate(zip(flat, tripled, strict=True))],
                 sequence.boxes[0]) == expected  # fmt: skip


def test_a_color_target_survives_gray_frames(frames, clip):
    mixed = [frames[0], *[cv2.cvtColor(f, cv2.COLOR_BGR2GRAY) if i % 3 else f for i, f in enumerate(frames[1:12])]]
    results = track(DEFAULT, mixed, clip.boxes[0])
    assert overlap(boxes_of(results), clip.boxes[:12]).min() > 0.5


@settings(max_examples=12)
@given(st.integers(0, 24), st.integers(13, 27), st.sampled_from(list(PRESETS)))
def test_a_shifted_scene_gives_shifted_boxes(frames, clip, dx, dy, preset):
    """The same pixels in a frame that begins elsewhere give the same displacements, but for rounding."""

    def run(x, y):
        cut = [np.ascontiguousarray(frame[y : y + 200, x : x + 280]) for frame in frames[:5]]
        return boxes_of(track(PRESETS[preset], cut, clip.boxes[0] - (x, y, 0, 0)))

    assert run(dx, dy) == pytest.approx(run(20, 20) + np.array([20 - dx, 20 - dy, 0, 0]), abs=1e-3)


@pytest.mark.parametrize("factor", [2, 3])
@pytest.mark.parametrize("preset", PRESETS)
def test_a_larger_picture_gives_larger_boxes(preset, factor, frames, clip):
    larger = [cv2.resize(f, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR) for f in frames[:10]]
    small = boxes_of(track(PRESETS[preset], frames[:10], clip.boxes[0]))
    large = boxes_of(track(PRESETS[preset], larger, factor * clip.boxes[0]))
    assert overlap(large / factor, small).min() > 0.88


def test_a_mirrored_picture_gives_mirrored_boxes(frames, clip):
    straight = boxes_of(track(DEFAULT, frames[:10], clip.boxes[0]))
    x, y, w, h = clip.boxes[0]
    mirrored = boxes_of(track(DEFAULT, [f[:, ::-1] for f in frames[:10]], (320 - x - w, y, w, h)))
    mirrored[:, 0] = 320 - mirrored[:, 0] - mirrored[:, 2]
    assert overlap(mirrored, straight).min() > 0.75


@settings(max_examples=6)
@given(st.permutations(["gray", "fhog", "color_names"]))
def test_the_order_of_cues_does_not_matter(frames, clip, order):
    for config in PRESETS.values():
        expected = boxes_of(track(config, frames[:4], clip.boxes[0]))
        permuted = boxes_of(track(config.replace(features=tuple(order)), frames[:4], clip.boxes[0]))
        assert permuted == pytest.approx(expected, abs=1e-2)


@pytest.mark.parametrize(
    "changes",
    [
        {"features": ()},
        {"features": ("gray",)},
        {"features": ("fhog",), "color_histogram": False},
        {"color_histogram": False},
        {"num_scales": 1},
        {"num_scales": 5, "scale_step": 1.1},
        {"joint_filter": False},
        {"average": "filter", "background_interval": 0},
        {"probability": "raw"},
        {"probability": "clip", "sharpness": 2},
        {"window": "target"},
        {"window": "square"},
        {"patch_size": 101},
        {"patch_size": 32},
        {"scale_when_reliable": False},
        {"scale_interval": 1},
        {"scale_interval": 5},
        {"lost_after": 0},
    ],
    ids=str,
)
def test_every_choice_of_a_parameter_tracks(changes, frames, clip):
    results = track(DEFAULT.replace(**changes), frames[:15], clip.boxes[0])
    assert overlap(boxes_of(results), clip.boxes[:15]).mean() > (0.4 if changes == {"features": ()} else 0.7)
