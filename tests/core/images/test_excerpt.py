"""The part of a JPEG that is needed has the pixels of the whole, and damage anywhere is found."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest
import simplejpeg
from hypothesis import given
from hypothesis import strategies as st

from mfcmt_core.images import FrameError, FrameLimits, inspect
from mfcmt_core.images import decode as decoding
from mfcmt_core.images.decode import decode, decode_part
from mfcmt_core.images.excerpt import excerpt
from tests.core import jpegs

from .test_mend import ODD, PROGRESSIVE, SAMPLINGS, SEPARATE

LIMITS = FrameLimits()
KNOWN = ("4:4:4", "4:2:2", "4:2:0", "4:1:1", "4:4:0", "4:4:1", "2x2 1x2 1x2")
"""The samplings that TurboJPEG decodes. OpenCV decodes the others, always as a whole."""
SIZES = ((163, 117), (128, 96), (33, 240), (17, 9), (1, 1))


def textured(width, height):
    """Return a picture whose blocks all differ, with coefficients of every frequency."""
    noise = np.random.default_rng(width).integers(0, 60, (height, width, 3), dtype=np.uint8)
    return cv2.add(cv2.resize(jpegs.picture(), (width, height)), noise)


def rectangles(width, height):
    """Return rectangles in the corners, at the edges and inside, of one pixel and of many."""
    rng = np.random.default_rng(width * height)
    found = [(0, 0, 1, 1), (width - 1, height - 1, 1, 1), (0, height - 1, width, 1), (width // 2, 0, 1, height)]
    for _ in range(12):
        (x, right), (y, bottom) = (sorted(rng.integers(0, side + 1, 2)) for side in (width, height))
        found.append((min(x, width - 1), min(y, height - 1), max(right - x, 1), max(bottom - y, 1)))
    return [(int(x), int(y), int(w), int(h)) for x, y, w, h in found]


def plain(data):
    """Return all pixels as the decoder gives them, without a warning."""
    info = inspect(data, LIMITS)
    return simplejpeg.decode_jpeg(data, "GRAY" if info.gray else "CMYK" if info.cmyk else "BGR")


def check_parts(data):
    """Check that every rectangle of the excerpts of ``data`` equals that of the whole picture."""
    whole = plain(data)
    height, width = whole.shape[:2]
    for x, y, w, h in rectangles(width, height):
        small, (left, top) = excerpt(data, (x, y, w, h))
        part = plain(small)[top : top + h, left : left + w]
        assert np.array_equal(part, whole[y : y + h, x : x + w]), (x, y, w, h)


@pytest.mark.parametrize("restart", [0, 1, 7])
@pytest.mark.parametrize("name", KNOWN)
def test_a_part_has_the_pixels_of_the_whole_in_every_sampling(name, restart):
    for size in SIZES[:3]:
        check_parts(jpegs.written(textured(*size), SAMPLINGS[name], restart=restart))


@pytest.mark.parametrize("name", sorted(SAMPLINGS.keys() - set(KNOWN)))
def test_a_picture_of_a_rare_sampling_is_decoded_as_a_whole(name, monkeypatch):
    monkeypatch.setattr(decoding, "LEAST_SAVED", 0)
    data = jpegs.written(textured(163, 117), SAMPLINGS[name])
    image, offset = decode_part(data, inspect(data, LIMITS), (70, 50, 20, 30))
    assert offset == (0, 0)
    assert np.array_equal(image, decode(data, LIMITS)[0])


KINDS = {
    "quality 100": (cv2.IMWRITE_JPEG_QUALITY, 100),
    "quality 10": (cv2.IMWRITE_JPEG_QUALITY, 10),
    "its own tables": (cv2.IMWRITE_JPEG_OPTIMIZE, 1),
    "its own tables, quality 100": (cv2.IMWRITE_JPEG_OPTIMIZE, 1, cv2.IMWRITE_JPEG_QUALITY, 100),
    "a restart after each row": (cv2.IMWRITE_JPEG_RST_INTERVAL, 11),
}


@pytest.mark.parametrize("gray", [False, True], ids=["color", "gray"])
@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("options", KINDS.values(), ids=KINDS)
def test_a_part_has_the_pixels_of_the_whole_in_every_size(options, size, gray):
    image = textured(*size)
    check_parts(jpegs.encode(image[..., 0] if gray else image, *options))


def test_a_part_of_a_frame_of_video_without_tables_has_the_pixels_of_the_whole():
    check_parts(jpegs.without_tables(jpegs.plain()))


def test_a_part_of_a_cmyk_picture_has_the_pixels_of_the_whole():
    pil = pytest.importorskip("PIL.Image")
    file = io.BytesIO()
    pil.fromarray(textured(163, 117)).convert("CMYK").save(file, "jpeg", quality=95)
    check_parts(file.getvalue())


def test_a_part_of_a_gray_picture_with_sampling_factors_has_the_pixels_of_the_whole():
    check_parts(jpegs.written(textured(163, 117)[..., 0], [(2, 2)]))


@pytest.mark.parametrize("data", [PROGRESSIVE, SEPARATE], ids=["progressive", "separate scans"])
def test_a_picture_of_several_scans_has_no_excerpt(data):
    assert excerpt(data, (0, 0, 9, 9)) is None


@pytest.mark.parametrize(("odd", "good"), ODD.values(), ids=ODD)
def test_a_part_of_a_faulty_form_has_the_pixels_of_the_whole(odd, good, monkeypatch):
    monkeypatch.setattr(decoding, "LEAST_SAVED", 0)
    image, (x, y) = decode_part(odd, inspect(odd, LIMITS), (70, 50, 20, 30))
    whole = decode(good, LIMITS)[0]
    assert np.array_equal(image, whole[y : y + image.shape[0], x : x + image.shape[1]])


@pytest.mark.parametrize("more", [b"\0", b"\xff", b"\xff\xe2\0\0", b"\xff\xe2\0\1", b"\xff\xf7\0\2"])
def test_a_header_that_is_not_plainly_segment_after_segment_leaves_no_excerpt(more):
    data = jpegs.plain()
    for at, _ in jpegs.segments(data)[0]:
        assert excerpt(jpegs.insert(data, at, more), (0, 0, 9, 9)) is None
    assert excerpt(data, (0, 0, 9, 9)) is not None


@pytest.mark.parametrize("restart", [0, 5])
def test_missing_data_leave_no_excerpt(restart):
    data = jpegs.with_restarts(restart) if restart else jpegs.plain()
    first = jpegs.segments(data)[1]
    for at in range(first, len(data) - 2, 61):
        for broken in (data[:at], data[:at] + b"\xff\xd9", data[:at] + data):
            assert excerpt(broken, (0, 0, 9, 9)) is None


SAMPLES = {
    "plain": jpegs.plain(),
    "restarts": jpegs.with_restarts(5),
    "its own tables": jpegs.plain(cv2.IMWRITE_JPEG_OPTIMIZE, 1),
    "gray": jpegs.encode(jpegs.picture()[..., 0]),
}


@given(st.sampled_from(sorted(SAMPLES)), st.booleans(), st.integers(0, 10**6), st.integers(1, 255))
def test_a_damaged_picture_has_a_part_only_if_the_whole_is_decoded(name, in_header, place, change):
    data = bytearray(SAMPLES[name])
    place %= jpegs.segments(SAMPLES[name])[1] if in_header else len(data)
    data[place] ^= change
    damaged = bytes(data)
    try:
        info = inspect(damaged, LIMITS)
    except FrameError:
        return
    needed = (info.width // 3, info.height // 3, max(info.width // 4, 1), max(info.height // 4, 1))
    x, y, w, h = needed
    part = decoding._jpeg_part(damaged, info, needed)
    if part is not None:
        assert np.array_equal(part, decode(damaged, LIMITS)[0][y : y + h, x : x + w])


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_part_of_a_turned_picture_has_the_pixels_of_the_whole(orientation, monkeypatch):
    monkeypatch.setattr(decoding, "LEAST_SAVED", 0)
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\1\3\0\1\0\0\0" + bytes([orientation]) + bytes(7)
    data = jpegs.insert(jpegs.encode(textured(163, 117)), 2, jpegs.segment(0xE1, exif))
    whole, info = decode(data, LIMITS)
    assert info.orientation == orientation
    for needed in ((3, 5, 40, 20), (100, 90, 17, 27), (60, 40, 1, 1)):
        x, y, w, h = needed
        image, offset = decode_part(data, info, needed)
        assert offset == (x, y)
        assert np.array_equal(image, whole[y : y + h, x : x + w])


def test_where_little_can_be_left_out_the_whole_is_decoded():
    data = jpegs.encode(textured(640, 480))
    info = inspect(data, LIMITS)
    for needed, whole in (((200, 100, 300, 300), False), ((10, 10, 600, 400), True)):
        image, offset = decode_part(data, info, needed)
        assert (image.shape[:2] == (480, 640)) == whole
        assert offset == ((0, 0) if whole else needed[:2])
    png = cv2.imencode(".png", textured(640, 480))[1].tobytes()
    assert decode_part(png, inspect(png, LIMITS), (200, 100, 30, 30))[0].shape == (480, 640, 3)


def test_real_frames_have_parts_with_the_pixels_of_the_whole(otb_root):
    for path in sorted(otb_root.glob("*/img/0001.jpg"))[::4]:
        check_parts(path.read_bytes())
