"""Pixels: of every kind that is accepted, turned as EXIF says, and none from damaged data."""

from __future__ import annotations

import io
import os
import resource
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings

from mfcmt_core.images import FrameError, FrameLimits
from mfcmt_core.images.decode import Image, decode

from . import images
from .images import encode, jpeg, picture
from .test_header import damaged

LIMITS = FrameLimits()


def close(a: Image, b: Image, within: float = 3) -> bool:
    return a.shape == b.shape and float(np.abs(a.astype(int) - b).mean()) <= within


@pytest.mark.parametrize("gray", [False, True])
@pytest.mark.parametrize(
    ("extension", "options", "within"),
    [
        (".jpg", (), 3),
        (".jpg", images.PROGRESSIVE, 3),
        (".png", (), 0),
        (".webp", (), 0),
        (".webp", (64, 90), 4),
    ],
)
def test_kinds(extension: str, options: tuple[int, ...], within: float, gray: bool) -> None:
    source = picture(gray=gray)
    image, info = decode(encode(extension, source, *options), LIMITS)
    if gray and extension == ".webp":  # WebP has no grey
        source = cv2.cvtColor(source, cv2.COLOR_GRAY2BGR)
    assert image.dtype == np.uint8
    assert image.flags.c_contiguous
    assert close(image, source, within)
    assert info.gray == (image.ndim == 2)


def test_deep_and_alpha() -> None:
    source = picture()
    deep, _ = decode(encode(".png", source.astype(np.uint16) * 257), LIMITS)
    assert np.array_equal(deep, source)
    alpha, _ = decode(encode(".png", np.dstack([source, source[:, :, 0]])), LIMITS)
    assert np.array_equal(alpha, source)


def test_cmyk() -> None:
    pil = pytest.importorskip("PIL.Image")
    file = io.BytesIO()
    pil.fromarray(picture()[:, :, ::-1]).convert("CMYK").save(file, "jpeg", quality=95)
    image, info = decode(file.getvalue(), LIMITS)
    assert info.cmyk
    assert close(image, picture())


@pytest.mark.parametrize("kind", ["jpeg", "png", "webp"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation(kind: str, orientation: int) -> None:
    source = picture()
    upright = {
        1: lambda a: a,
        2: np.fliplr,
        3: lambda a: np.rot90(a, 2),
        4: np.flipud,
        5: lambda a: a.swapaxes(0, 1),
        6: lambda a: np.rot90(a, -1),
        7: lambda a: np.rot90(a, 2).swapaxes(0, 1),
        8: np.rot90,
    }[orientation](source)
    image, info = decode(images.oriented(kind, source, orientation), LIMITS)
    assert close(image, upright)
    assert image.flags.c_contiguous
    assert (info.height, info.width) == image.shape[:2]


@pytest.mark.parametrize("options", [(), images.PROGRESSIVE])
@pytest.mark.parametrize("gray", [False, True])
def test_truncated_with_an_end_glued_on(options: tuple[int, ...], gray: bool) -> None:
    """OpenCV alone makes a picture with grey fill of these."""
    data = jpeg(*options, gray=gray)
    for percent in range(5, 100, 5):
        with pytest.raises(FrameError) as error:
            decode(data[: (len(data) - 2) * percent // 100] + b"\xff\xd9", LIMITS)
        assert error.value.code == "frame-undecodable"


def test_damaged_png(capfd: pytest.CaptureFixture[str]) -> None:
    data = encode(".png", picture())
    for at in range(40, len(data) - 12, len(data) // 20):
        with pytest.raises(FrameError) as error:
            decode(images.patched(data, at, data[at] ^ 0x55), LIMITS)
        assert error.value.code == "frame-undecodable"
    assert capfd.readouterr().err == ""


PNG = encode(".png", picture(32, 24))
ROWS = zlib.compress(bytes(24 * (1 + 3 * 32)))
ODD_PNG = {
    "iCCP": PNG[:33] + images.chunk(b"iCCP", b"bad\0\0profile") + PNG[33:],
    "sRGB": PNG[:33] + images.chunk(b"sRGB", b"\x09") + PNG[33:],
    "tRNS": PNG[:33] + images.chunk(b"tRNS", bytes(5)) + PNG[33:],
    "zTXt": PNG[:33] + images.chunk(b"zTXt", b"key\0\0text") + PNG[33:],
    "eXIf": PNG[:33] + images.chunk(b"eXIf", b"zz") + PNG[33:],
    "too many rows": PNG[:33] + images.chunk(b"IDAT", zlib.compress(bytes(9999))) + PNG[-12:],
}
BAD_PNG = {
    "too few rows": PNG[:33] + images.chunk(b"IDAT", zlib.compress(bytes(99))) + PNG[-12:],
    "no rows": PNG[:33] + images.chunk(b"IDAT", b"") + PNG[-12:],
    "not deflated": PNG[:33] + images.chunk(b"IDAT", bytes(99)) + PNG[-12:],
    "cut": PNG[:33] + images.chunk(b"IDAT", ROWS[:-4]) + PNG[-12:],
    "unknown filter": PNG[:33] + images.chunk(b"IDAT", zlib.compress(b"\x09" * 24 * 97)) + PNG[-12:],
    "unknown chunk": PNG[:33] + images.chunk(b"ABCD", b"") + PNG[33:],
    "two headers": PNG[:33] + PNG[8:],
    "no palette": PNG[:8] + images.chunk(b"IHDR", PNG[16:25] + b"\3\0\0\0") + PNG[33:],
    "3 bits": PNG[:8] + images.chunk(b"IHDR", PNG[16:24] + b"\3\0\0\0\0") + PNG[33:],
}


@pytest.mark.parametrize("data", ODD_PNG.values(), ids=ODD_PNG)
def test_an_odd_png_prints_nothing(data: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    """A line of its own would break the log, which is JSON."""
    assert decode(data, LIMITS)[0].shape == (24, 32, 3)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("data", BAD_PNG.values(), ids=BAD_PNG)
def test_a_bad_png_prints_nothing(data: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(FrameError) as error:
        decode(data, LIMITS)
    assert error.value.code == "frame-undecodable"
    assert capfd.readouterr() == ("", "")


def test_the_standard_error_works_after_decoding(capfd: pytest.CaptureFixture[str]) -> None:
    decode(PNG, LIMITS)
    os.write(2, b"said")
    assert capfd.readouterr().err == "said"


def test_a_decompression_bomb_costs_nothing() -> None:
    """Refused by the header: nothing of the declared size is ever allocated."""

    def peak_kb() -> int:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    bombs = (
        images.with_size(jpeg(), 32000, 32000),
        images.with_size(jpeg(), 65500, 65500),
        images.png_header(12000, 12000),
        images.riff(images.vp8x(16000, 16000), encode(".webp", picture())[12:]),
        images.scan_bomb(20_000),
    )
    before = peak_kb()
    for data in bombs:
        with pytest.raises(FrameError) as error:
            decode(data, LIMITS)
        assert error.value.code == "frame-too-large"
    assert peak_kb() - before < 50_000


@settings(max_examples=300)
@given(damaged())
def test_fuzz(data: bytes) -> None:
    try:
        image, info = decode(data, FrameLimits(max_pixels=1_000_000, max_scans=8))
    except FrameError:
        return
    assert image.shape[:2] == (info.height, info.width)


def test_real_frames_are_decoded(otb_root: Path) -> None:
    seen = 0
    for path in sorted(otb_root.glob("*/img/*1.jpg"))[::10]:
        data = path.read_bytes()
        image, info = decode(data, LIMITS)
        theirs = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        assert theirs is not None
        assert image.shape == theirs.shape
        assert info.gray == (image.ndim == 2)
        assert float(np.abs(image.astype(int) - theirs).mean()) < 1
        seen += 1
    assert seen > 50
