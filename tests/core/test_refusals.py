"""Bad input: an exception of the package with the offending value, and nothing has changed."""

from __future__ import annotations

import numpy as np
import pytest

import mfcmt_core
from mfcmt_core import (
    MFCMT,
    BadBox,
    BadConfig,
    BadImage,
    BadSnapshot,
    MFCMTError,
    NotInitialised,
    RegionTooSmall,
)

NAN, INF = float("nan"), float("inf")

BOXES = [
    (NAN, 0, 10, 10),
    (0, 0, INF, 10),
    (0, 0, 10, -INF),
    (10, 10, 0, 10),
    (10, 10, 10, -5),
    (10, 10, 1e-300, 10),
    (-1000, 10, 30, 30),
    (310, 230, 100, 100),  # a hundredth inside
    (1e308, 0, 1e308, 10),
    (10**400, 0, 10, 10),
    (1, 2, 3),
    (1, 2, 3, 4, 5),
    (),
    None,
    7,
    "1234",
    b"1234",
    "box",
    (1, 2, 3, None),
    (1, 2, 3, "x"),
    (1, 2, 3, 4j),
    np.ones((4, 2)),
    {"x": 1},
]

IMAGES = [
    None,
    "frame.jpg",
    [],
    [[1, 2], [3, 4]],
    np.zeros((240, 320, 3)),
    np.zeros((240, 320, 3), np.int8),
    np.zeros((240, 320, 3), bool),
    np.zeros((240, 320, 3), np.uint16),
    np.zeros((240, 320, 3), object),
    np.zeros((240, 320, 1), np.uint8),
    np.zeros((240, 320, 4), np.uint8),
    np.zeros((3, 240, 320), np.uint8),
    np.zeros((1, 240, 320, 3), np.uint8),
    np.zeros(240, np.uint8),
    np.zeros((), np.uint8),
    np.zeros((0, 320, 3), np.uint8),
    np.zeros((240, 0), np.uint8),
]

CUTS = [
    {"offset": (1, 0)},
    {"offset": (-1, 0)},
    {"offset": (0, 0), "frame_size": (319, 240)},
    {"offset": (10, 0), "frame_size": (320, 240)},
    {"offset": (NAN, 0)},
    {"offset": None},
    {"offset": (0.5, 0)},
    {"offset": "ab"},
    {"frame_size": (INF, 240)},
    {"frame_size": (320,)},
    {"frame_size": (10**30, 10**30)},
    {"frame_size": "large"},
]


@pytest.fixture
def running(frames, clip):
    """Return a tracker in the middle of a clip."""
    tracker = MFCMT()
    tracker.init(frames[0], clip.boxes[0])
    tracker.update(frames[1])
    return tracker


@pytest.fixture
def unchanged(running, frames):
    """Assert that the test leaves the tracker unchanged to the last bit, and able to go on."""
    before = running.to_bytes()
    expected = MFCMT.from_bytes(before).update(frames[2])
    yield
    assert running.to_bytes() == before
    assert running.update(frames[2]) == expected


@pytest.mark.usefixtures("unchanged")
@pytest.mark.parametrize("box", BOXES, ids=repr)
def test_a_bad_box_is_refused_and_changes_nothing(box, running, frames):
    with pytest.raises(BadBox):
        running.init(frames[5], box)
    with pytest.raises(BadBox):
        MFCMT().init(frames[5], box)


@pytest.mark.usefixtures("unchanged")
@pytest.mark.parametrize("image", IMAGES, ids=lambda v: f"{getattr(v, 'dtype', v)}{getattr(v, 'shape', '')}")
def test_a_bad_image_is_refused_and_changes_nothing(image, running, clip):
    with pytest.raises(BadImage):
        running.update(image)
    with pytest.raises(BadImage):
        running.init(image, clip.boxes[0])


@pytest.mark.usefixtures("unchanged")
@pytest.mark.parametrize("shape", [(239, 320, 3), (240, 321, 3), (480, 640, 3), (320, 240), (1, 1)])
def test_another_frame_size_is_refused(shape, running):
    with pytest.raises(BadImage, match=r"\(320, 240\)"):
        running.update(np.zeros(shape, np.uint8))


@pytest.mark.usefixtures("unchanged")
@pytest.mark.parametrize("cut", CUTS, ids=str)
def test_a_bad_region_is_refused(cut, running, frames, clip):
    with pytest.raises(BadImage):
        running.update(frames[2], **cut)
    with pytest.raises(BadImage):
        running.init(frames[2], clip.boxes[2], **cut)


@pytest.mark.usefixtures("unchanged")
@pytest.mark.parametrize("missing", range(4))
def test_a_region_that_is_too_small_is_refused(missing, running, frames, clip):
    """The region lacks one row or column of the needed one."""
    x, y, w, h = running.needed_region()
    x0, y0, x1, y1 = x + (missing == 0), y + (missing == 1), x + w - (missing == 2), y + h - (missing == 3)
    cut = frames[2][y0:y1, x0:x1]
    with pytest.raises(RegionTooSmall) as caught:
        running.update(cut, offset=(x0, y0), frame_size=(320, 240))
    assert caught.value.needed == (x, y, w, h)
    assert caught.value.given == (x0, y0, x1 - x0, y1 - y0)
    assert str((x, y, w, h)) in str(caught.value)
    with pytest.raises(RegionTooSmall):
        running.init(frames[2][90:150, 130:200], clip.boxes[2], offset=(130, 90), frame_size=(320, 240))


def test_a_refused_start_does_not_start(frames):
    tracker = MFCMT()
    with pytest.raises(BadBox):
        tracker.init(frames[0], (0, 0, 0, 0))
    with pytest.raises(NotInitialised):
        tracker.update(frames[0])


@pytest.mark.parametrize(
    "call",
    [
        lambda t, f: t.update(f),
        lambda t, f: t.update(None),
        lambda t, f: t.to_bytes(),
        lambda t, f: t.needed_region(),
        lambda t, f: t.region(),
    ],
)
def test_calls_before_init_are_refused(call, frames):
    with pytest.raises(NotInitialised, match="init"):
        call(MFCMT(), frames[0])


def test_track_ends_at_a_bad_frame(frames, clip):
    results = MFCMT().track([frames[0], frames[1], None, frames[2]], clip.boxes[0])
    next(results)
    next(results)
    with pytest.raises(BadImage):
        next(results)


@pytest.mark.parametrize(
    ("error", "builtin"),
    [
        (BadBox, ValueError),
        (BadImage, ValueError),
        (BadSnapshot, ValueError),
        (BadConfig, ValueError),
        (RegionTooSmall, ValueError),
        (NotInitialised, RuntimeError),
    ],
)
def test_every_error_derives_from_the_package_s_base(error, builtin):
    assert issubclass(error, MFCMTError)
    assert issubclass(error, builtin)
    assert error.__name__ in mfcmt_core.__all__


def test_errors_name_the_value(frames):
    tracker = MFCMT()
    with pytest.raises(BadBox, match="-5"):
        tracker.init(frames[0], (10, 10, 20, -5))
    with pytest.raises(BadImage, match="float64"):
        tracker.init(np.zeros((10, 10)), (1, 1, 5, 5))
    with pytest.raises(BadImage, match=r"\(10, 10, 4\)"):
        tracker.init(np.zeros((10, 10, 4), np.uint8), (1, 1, 5, 5))
    with pytest.raises(BadBox) as caught:
        tracker.init(frames[0], "9" * 100_000)
    assert len(str(caught.value)) < 300
