"""Boxes, cuts of frames, and the maps between image, patch and cells."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfcmt_core import BadBox, BadImage, MFCMTConfig, RegionTooSmall
from mfcmt_core.geometry import Frame, SearchWindow, _columns, check_box, clip_rect, grow_rect
from mfcmt_core.target import Crop, Observation

CONFIG = MFCMTConfig.default()
SIDE = st.floats(1e-3, 2000)
PLACE = st.floats(-500, 3000)


# --- boxes ---


@settings(max_examples=200)
@given(PLACE, PLACE, SIDE, SIDE)
def test_a_box_needs_a_quarter_of_its_area_in_the_frame(x, y, w, h):
    w, h = max(w, 1), max(h, 1)
    inside = max(min(x + w, 640) - max(x, 0), 0) * max(min(y + h, 480) - max(y, 0), 0)
    if inside > 0.2501 * w * h:
        assert check_box((x, y, w, h), (640, 480)) == (x, y, w, h)
    elif inside < 0.2499 * w * h:
        with pytest.raises(BadBox):
            check_box((x, y, w, h), (640, 480))


def test_a_box_below_a_pixel_is_refused_with_a_hint_to_fractions():
    with pytest.raises(BadBox, match="pixels and not shares of the frame"):
        check_box((0.4, 0.33, 0.2, 0.32), (640, 480))
    with pytest.raises(BadBox, match=r"less than a pixel; a box is x, y, w, h in pixels \("):
        check_box((40, 33, 20, 0.99), (640, 480))
    assert check_box((40, 33, 1, 1), (640, 480)) == (40, 33, 1, 1)


def test_a_box_outside_the_frame_is_refused_with_a_hint_to_corners():
    with pytest.raises(BadBox, match=r"in the frame of 640x480; a box is x, y, w, h \("):
        check_box((700, 10, 30, 30), (640, 480))
    with pytest.raises(BadBox, match="as corners x1, y1, x2, y2"):
        check_box((500, 400, 560, 470), (640, 480))
    with pytest.raises(BadBox, match=r"a box is x, y, w, h \("):
        check_box((500, 400, 700, 470), (640, 480))


@pytest.mark.parametrize("kind", [tuple, list, np.array, iter, lambda v: np.array(v, np.float32), lambda v: (*v,)])
def test_a_box_may_be_any_iterable_of_four_numbers(kind):
    box = check_box(kind([1, 2, 30, 40]), (100, 100))
    assert box == (1, 2, 30, 40)
    assert all(type(v) is float for v in box)


# --- rectangles ---

RECT = st.tuples(st.integers(-50, 150), st.integers(-50, 150), st.integers(1, 200), st.integers(1, 200))


@settings(max_examples=200)
@given(RECT)
def test_clip_rect(rect):
    x, y, w, h = clip_rect(rect, (100, 80))
    assert w >= 1
    assert h >= 1
    assert x >= 0
    assert x + w <= 100
    assert y >= 0
    assert y + h <= 80
    assert clip_rect((x, y, w, h), (100, 80)) == (x, y, w, h)
    inside = {(i, j) for i in range(rect[0], rect[0] + rect[2]) for j in (rect[1],) if 0 <= i < 100}
    if inside:
        assert (x, x + w) == (min(inside)[0], max(inside)[0] + 1)


def test_grow_rect_rounds_outwards():
    assert grow_rect((10, 20, 30, 40), 2.1, 0) == (7, 20, 36, 40)


# --- cuts of frames ---


def looked_up(start, length, out, low, extent):
    """Return the sampled coordinates of one axis; those outside the region are clipped to it."""
    step = max(length // (2 * out), 1)
    places = start + step * np.arange(length // step)
    inside = places[(places >= low) & (places < low + extent)]
    if len(inside):
        return np.clip(places, inside.min(), inside.max())
    return np.full_like(places, low if start < low else low + extent - 1)


def sample_reference(image, rect, within, out_size):
    """Look up each pixel by itself, then resize once."""
    columns, rows = (looked_up(rect[k], rect[k + 2], out_size[k], within[k], within[k + 2]) for k in (0, 1))
    return cv2.resize(image[np.ix_(rows, columns)], out_size, interpolation=cv2.INTER_LINEAR)


@settings(max_examples=200)
@given(
    st.tuples(st.integers(-300, 300), st.integers(-300, 300), st.integers(2, 400), st.integers(2, 400)),
    st.tuples(st.integers(0, 79), st.integers(0, 59), st.integers(1, 80), st.integers(1, 60)),
    st.sampled_from([(10, 10), (20, 12), (32, 32)]),
    st.booleans(),
)
def test_sample_repeats_the_border_of_the_region(rect, region, out_size, in_color):
    image = np.random.default_rng(0).integers(0, 256, (60, 80, 3) if in_color else (60, 80), np.uint8)
    within = clip_rect(region, (80, 60))
    sampled = Frame.of(image).sample(rect, within, out_size)
    assert np.array_equal(sampled, sample_reference(image, rect, within, out_size))
    # and only pixels of the region decide
    masked = np.zeros_like(image)
    x, y, w, h = within
    masked[y : y + h, x : x + w] = image[y : y + h, x : x + w]
    assert np.array_equal(Frame.of(masked).sample(rect, within, out_size), sampled)
    crop = np.ascontiguousarray(image[y : y + h, x : x + w])
    assert np.array_equal(Frame.of(crop, (x, y), (80, 60)).sample(rect, within, out_size), sampled)


@pytest.mark.parametrize("step", [1, 2, 3, 7, 49])
@pytest.mark.parametrize("kind", ["whole", "upside down", "mirrored", "thinned", "other channels", "by columns"])
def test_columns_equal_a_slice(step, kind):
    """This holds for steps that do not divide the width, and for steps s with 1 / (1 / s) ≠ s."""
    image = np.random.default_rng(step).integers(0, 256, (20, 301, 3), np.uint8)
    rows = {
        "whole": image,
        "upside down": image[::-1],
        "mirrored": image[:, ::-1],
        "thinned": image[::3, ::2],
        "other channels": image[..., ::-1],
        "by columns": np.asfortranarray(image),
    }[kind]
    width = rows.shape[1]
    for first, last in [(0, width), (5, width), (width - 1, width), (3, 4), (10, width - 9)]:
        assert np.array_equal(_columns(rows, first, last, step), rows[:, first:last:step])


def test_a_frame_without_the_needed_pixels_is_refused():
    frame = Frame.of(np.zeros((40, 50), np.uint8), (10, 20), (100, 100))
    assert frame.rect == (10, 20, 50, 40)
    frame.require((10, 20, 50, 40))
    for needed in ((9, 20, 10, 10), (10, 19, 10, 10), (51, 20, 10, 10), (10, 51, 10, 10)):
        with pytest.raises(RegionTooSmall) as caught:
            frame.require(needed)
        assert caught.value.needed == needed
        assert caught.value.given == (10, 20, 50, 40)


@pytest.mark.parametrize("offset", [(-1, 0), (51, 0), (0, 61), (0.5, 0), None, (1,), (float("nan"), 0), "ab"])
def test_a_region_must_lie_in_its_frame(offset):
    with pytest.raises(BadImage):
        Frame.of(np.zeros((40, 50), np.uint8), offset, (100, 100))


# --- the search window ---


def middle_of(patch):
    """Return the observation in the middle of ``patch`` for a target without models."""
    nothing = np.empty(0, np.uint8)
    return Observation(Crop(patch, 1.0, nothing, nothing, nothing), (0, 0), nothing, nothing)


@pytest.mark.parametrize("base", [(40.0, 30.0), (30.0, 81.0), (8.0, 8.0), (1000.0, 640.0), (4.0, 400.0)])
@pytest.mark.parametrize("factor", [1.5, 2.0, 2.5])
def test_windows_have_the_size_of_their_shape(base, factor):
    w, h = base
    expected = {
        "target": (factor * w, factor * h),
        "context": (w + (factor - 1) * (w + h) / 2, h + (factor - 1) * (w + h) / 2),
        "square": (factor * np.sqrt(w * h), factor * np.sqrt(w * h)),
    }
    for window, extent in expected.items():
        search = SearchWindow(CONFIG.replace(window=window, search_area_scale=factor), base)
        assert search.extent == pytest.approx(extent)
        assert search.cells == CONFIG.patch_size // 4
        assert search.target == pytest.approx((search.cells * w / extent[0], search.cells * h / extent[1]))
        for reach, target in zip(search.reach, search.target, strict=True):
            assert 2 <= reach <= (search.cells - 1) // 2
            assert reach == 2 or reach <= (search.cells - target) / 2  # the target stays in the window


def test_paper_s_window_is_twice_the_target_at_150():
    search = SearchWindow(MFCMTConfig.paper(), (40.0, 90.0))
    assert search.extent == (80, 180)
    assert search.patch_size == 150
    assert search.cells == 37


@settings(max_examples=100)
@given(
    st.floats(0, 640),
    st.floats(0, 480),
    st.floats(2, 300),
    st.floats(2, 300),
    st.floats(0.2, 5),
    st.integers(-12, 12),
    st.integers(-12, 12),
    st.sampled_from([0.0, 1.0]),
)
def test_displacements_count_from_the_middle_of_the_whole_pixel_window(x, y, w, h, scale, dx, dy, learn_within):
    search = SearchWindow(CONFIG.replace(learn_within=learn_within), (w, h))
    image = np.zeros((480, 640), np.uint8)
    patch = search.crop(Frame.of(image), (0, 0, 640, 480), (x, y), scale)
    side, exact = len(patch.pixels), search.extent[0] * scale * len(patch.pixels) / search.patch_size
    assert side == search.patch_size + 2 * search.margin
    rx, ry, rw, rh = patch.rect
    assert patch.rect == search.rect((x, y), scale, side / search.patch_size)
    assert abs(rw - exact) <= max(0.5, 2 - exact) + 1e-9
    assert patch.center == (rx + rw / 2, ry + rh / 2)
    assert abs(patch.center[0] - x) <= 0.5 + 1e-9
    assert abs(patch.center[1] - y) <= 0.5 + 1e-9
    place = middle_of(patch).place_at((dx, dy))
    # a cell is four pixels of the patch, which are (rw, rh) / (patch_size + 2·margin) pixels of the frame each
    assert place[0] - patch.center[0] == pytest.approx(4 * dx * rw / side)
    assert place[1] - patch.center[1] == pytest.approx(4 * dy * rh / side)


def test_a_real_shift_has_its_displacement():
    """A displacement in a patch that shows the image shifted by whole cells gives the place."""
    search = SearchWindow(CONFIG, (40.0, 40.0))  # window of 100×100 and 12 around: a patch pixel is an image pixel
    image = np.random.default_rng(3).integers(0, 256, (300, 300), np.uint8)
    frame, within = Frame.of(image), (0, 0, 300, 300)
    here = search.crop(frame, within, (150.0, 150.0), 1.0)
    there = search.crop(frame, within, (158.0, 146.0), 1.0)
    assert here.pixels.shape == (124, 124)
    assert np.array_equal(here.pixels[:114, 10:], there.pixels[4:118, 2:116])
    assert middle_of(here).place_at((2, -1)) == there.center


@pytest.mark.parametrize("patch_size", [32, 100, 150])
def test_a_window_has_a_margin_if_nearby_windows_are_learned(patch_size):
    """The margin is an eighth of the patch on each side; the middle equals the patch without a margin."""
    config = CONFIG.replace(patch_size=patch_size)
    with_margin, without = (SearchWindow(config.replace(learn_within=cells), (40.0, 40.0)) for cells in (1.0, 0.0))
    assert with_margin.margin == patch_size // 8
    assert without.margin == 0
    assert with_margin.rect((50.0, 50.0), 1.0) == without.rect((50.0, 50.0), 1.0)
    image = np.random.default_rng(4).integers(0, 256, (400, 400, 3), np.uint8)
    scale = patch_size / 100  # a patch pixel is an image pixel
    wide, plain = (w.crop(Frame.of(image), (0, 0, 400, 400), (200.0, 200.0), scale) for w in (with_margin, without))
    assert wide.step == plain.step == (1, 1)
    assert wide.center == plain.center
    inner = slice(with_margin.margin, with_margin.margin + patch_size)
    assert np.array_equal(wide.pixels[inner, inner], plain.pixels)


def test_paper_s_window_has_no_margin():
    assert SearchWindow(MFCMTConfig.paper(), (40.0, 90.0)).margin == 0
