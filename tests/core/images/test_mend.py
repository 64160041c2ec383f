"""JPEGs whose picture is whole are read however odd their form is; those that lack data are refused, odd or not."""

from __future__ import annotations

import io
from functools import partial

import cv2
import numpy as np
import pytest
import simplejpeg

from mfcmt_core.images import FrameError, FrameLimits
from mfcmt_core.images.decode import decode
from mfcmt_core.images.mend import mend
from tests.core import jpegs

LIMITS = FrameLimits()
PLAIN, PROGRESSIVE = jpegs.plain(), jpegs.progressive()
RESTARTS = jpegs.with_restarts(3)
PROGRESSIVE_RESTARTS = jpegs.with_restarts(5, cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
SEPARATE = jpegs.written(jpegs.picture(), [(2, 2), (1, 1), (1, 1)], interleaved=False, restart=4)
WITHOUT_JFIF = PLAIN[:2] + PLAIN[20:]


def pixels(data):
    return decode(data, LIMITS)[0]


WRONG = jpegs.with_scan_parameters(jpegs.with_jfif(RESTARTS, 3, 7), 1, 2, 3)
SAMSUNG = b"\0\0\1\n\x0e\0\0\0Image_UTC_Data1600000000000SEFHk\0\0\0SEFT"
ODD = {
    f"{name} {where}": (change(good, more), good)
    for where, change, good in (
        ("between segments", jpegs.between_segments, PLAIN),
        ("before the scan", partial(jpegs.between_segments, marker=0xDA), PLAIN),
        ("before restarts", jpegs.before_restarts, RESTARTS),
        ("before the end", jpegs.before_end, PLAIN),
        ("in place of the end", jpegs.without_end, PLAIN),
    )
    for name, more in jpegs.STRAY.items()
} | {
    "one byte before some restarts": (jpegs.before_restarts(RESTARTS, b"\0", every=5), RESTARTS),
    "fill bytes before restarts": (jpegs.before_restarts(RESTARTS, b"\xff\xff"), RESTARTS),
    "no end": (jpegs.without_end(PLAIN), PLAIN),
    "half an end": (jpegs.without_end(PLAIN, b"\xff"), PLAIN),
    "the next picture in place of the end": (jpegs.without_end(PLAIN, PROGRESSIVE), PLAIN),
    "Samsung's trailer": (jpegs.without_end(PLAIN, SAMSUNG), PLAIN),
    "progressive, before the end": (jpegs.before_end(PROGRESSIVE, b"junk"), PROGRESSIVE),
    "progressive, no end": (jpegs.without_end(PROGRESSIVE, b"junk"), PROGRESSIVE),
    "progressive, before restarts": (jpegs.before_restarts(PROGRESSIVE_RESTARTS, b"junk"), PROGRESSIVE_RESTARTS),
    "progressive, between segments": (jpegs.between_segments(PROGRESSIVE, b"junk"), PROGRESSIVE),
    "separate scans, before restarts": (jpegs.before_restarts(SEPARATE, b"\0"), SEPARATE),
    "separate scans, no end": (jpegs.without_end(SEPARATE), SEPARATE),
    "JFIF 2.1": (jpegs.with_jfif(PLAIN, 2, 1), PLAIN),
    "JFIF 0.0": (jpegs.with_jfif(PLAIN, 0, 0), PLAIN),
    "JFIF 255.255": (jpegs.with_jfif(PLAIN, 255, 255), PLAIN),
    "scan 0 0 0": (jpegs.with_scan_parameters(PLAIN, 0, 0, 0), PLAIN),
    "scan 63 1 17": (jpegs.with_scan_parameters(PLAIN, 63, 1, 17), PLAIN),
    "damaged ICC profile": (jpegs.insert(PLAIN, 20, jpegs.damaged_icc()), PLAIN),
    "unknown transform of Adobe's": (jpegs.insert(WITHOUT_JFIF, 2, jpegs.adobe(9)), WITHOUT_JFIF),
    "no tables, before restarts": (jpegs.before_restarts(jpegs.without_tables(RESTARTS), b"\0"), RESTARTS),
    "all of it": (jpegs.without_end(jpegs.between_segments(jpegs.before_restarts(WRONG, b"\0"), b"\0")), RESTARTS),
}


@pytest.mark.parametrize(("odd", "good"), ODD.values(), ids=ODD)
def test_mending_a_faulty_form_changes_no_pixel(odd, good, capfd):
    assert np.array_equal(pixels(odd), pixels(good))
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(("odd", "good"), ODD.values(), ids=ODD)
def test_missing_data_are_refused_in_spite_of_a_faulty_form(odd, good):
    """The data are cut anywhere in the coded part, and end there, with an end marker, or with another picture."""
    first = odd.index(b"\xff\xda") + 20
    last = first + int((len(good) - jpegs.segments(good)[1]) * 0.95)
    for at in np.linspace(first, last, 12).astype(int):
        for broken in (odd[:at], odd[:at] + b"\xff\xd9", odd[:at] + PLAIN):
            with pytest.raises(FrameError) as refused:
                pixels(broken)
            assert refused.value.code == "frame-undecodable"


SAMPLINGS = {
    "4:4:4": [(1, 1)] * 3,
    "4:2:2": [(2, 1), (1, 1), (1, 1)],
    "4:2:0": [(2, 2), (1, 1), (1, 1)],
    "4:1:1": [(4, 1), (1, 1), (1, 1)],
    "4:4:0": [(1, 2), (1, 1), (1, 1)],
    "4:4:1": [(1, 4), (1, 1), (1, 1)],
    "4:1:0": [(4, 2), (1, 1), (1, 1)],
    "2x2 1x1 2x1": [(2, 2), (1, 1), (2, 1)],
    "2x2 1x1 1x2": [(2, 2), (1, 1), (1, 2)],
    "2x1 1x1 2x1": [(2, 1), (1, 1), (2, 1)],
    "1x1 2x1 2x1": [(1, 1), (2, 1), (2, 1)],
    "3x1": [(3, 1), (1, 1), (1, 1)],
    "1x3": [(1, 3), (1, 1), (1, 1)],
    "3x2": [(3, 2), (1, 1), (1, 1)],
    "2x2 2x1 1x2": [(2, 2), (2, 1), (1, 2)],
    "2x2 1x2 1x2": [(2, 2), (1, 2), (1, 2)],
}


@pytest.mark.parametrize("stray", [b"", b"\0"], ids=["plain", "stray"])
@pytest.mark.parametrize("interleaved", [True, False], ids=["together", "separate"])
@pytest.mark.parametrize("factors", SAMPLINGS.values(), ids=SAMPLINGS)
def test_every_chroma_sampling_is_decoded(factors, interleaved, stray, capfd):
    source = cv2.resize(jpegs.picture(), (163, 117))
    source = cv2.GaussianBlur(source, (0, 0), 4)  # so that what the sampling loses is little
    data = jpegs.before_restarts(jpegs.written(source, factors, interleaved=interleaved, restart=7), stray)
    assert np.abs(pixels(data).astype(int) - source).mean() < 5
    theirs = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert np.array_equal(pixels(data), theirs)
    capfd.readouterr()
    for at in range(len(data) // 2, len(data) - 2, len(data) // 20):
        with pytest.raises(FrameError):
            pixels(data[:at] + b"\xff\xd9")
    assert capfd.readouterr().err == ""


def test_a_sampling_that_no_decoder_supports_is_refused():
    with pytest.raises(FrameError):
        pixels(jpegs.written(jpegs.picture(), [(3, 1), (2, 1), (1, 1)]))


@pytest.mark.parametrize("kind", ["stray", "no end", "rst"])
def test_cmyk_is_decoded(kind):
    pil = pytest.importorskip("PIL.Image")
    file = io.BytesIO()
    pil.fromarray(jpegs.picture()[:, :, ::-1]).convert("CMYK").save(file, "jpeg", quality=95)
    data = file.getvalue()
    odd = {"stray": jpegs.between_segments(data, b"\0\0"), "no end": data[:-2], "rst": jpegs.before_end(data, b"abc")}
    assert np.array_equal(pixels(odd[kind]), pixels(data))


def test_a_mended_jpeg_decodes_without_a_warning():
    for odd, good in ODD.values():
        assert np.array_equal(simplejpeg.decode_jpeg(mend(odd), "BGR"), pixels(good))


def test_real_frames_are_not_changed(otb_root):
    """Mending loses nothing: the pixels equal OpenCV's bit for bit."""
    for path in sorted(otb_root.glob("*/img/0001.jpg"))[::4]:
        data = path.read_bytes()
        image = pixels(data)
        assert np.array_equal(pixels(mend(data)), image)
        assert np.array_equal(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED), image)


@pytest.mark.parametrize(
    "data",
    [
        b"\xff\xd8",
        b"\xff\xd8\xff\xd9",
        b"\xff\xd8\xff\xda",
        b"\xff\xd8\xff\xda\x00\x08\x01\x01\x00\x00\x3f\x00",
        b"\xff\xd8\xff\xc0\x00\x08\x08\x00\x10\x00\x10\x00\xff\xd9",
        b"\xff\xd8\xff\xc4\x00\x13\x00" + b"\xff" * 16,
        b"\xff\xd8\xff\xdd\x00\x02",
        PLAIN[:2] + b"\xff\xf7\x00\x02" + PLAIN[2:],
        PLAIN.replace(b"\xff\xda\x00\x0c\x03", b"\xff\xda\x00\x0c\x00"),
        PLAIN.replace(b"\xff\xda\x00\x0c\x03\x01\x00\x02", b"\xff\xda\x00\x0c\x03\x01\x00\x01"),
        PLAIN.replace(b"\xff\xda\x00\x0c\x03\x01\x00\x02", b"\xff\xda\x00\x0c\x03\x01\x70\x02"),
    ],
)
def test_bytes_that_are_no_jpeg_are_refused_with_a_reason(data):
    with pytest.raises(ValueError, match=r"\w+ \w+"):
        mend(data)
