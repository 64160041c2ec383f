"""What the header says is what the decoders deliver; what they would choke on is refused before."""

from __future__ import annotations

import subprocess
import sys

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mfcmt_core.images import FrameError, FrameInfo, FrameLimits, inspect, sniff
from mfcmt_core.images.decode import decode

from . import images
from .images import encode, jpeg, patched, picture, riff, riff_chunk, segment, sof, vp8x, with_size

LIMITS = FrameLimits()
JPEG, PNG, WEBP = jpeg(), encode(".png", picture()), encode(".webp", picture())
SOF = sof(JPEG)
SAMPLES = {"jpeg": JPEG, "progressive": jpeg(*images.PROGRESSIVE), "png": PNG, "webp": WEBP}


def refused(data: bytes, limits: FrameLimits = LIMITS) -> str:
    with pytest.raises(FrameError) as error:
        inspect(data, limits)
    assert error.value.detail
    return error.value.code


SOUND = {
    "jpeg": (JPEG, FrameInfo("jpeg", 160, 120)),
    "progressive": (jpeg(*images.PROGRESSIVE), FrameInfo("jpeg", 160, 120)),
    "grey": (jpeg(gray=True), FrameInfo("jpeg", 160, 120, gray=True)),
    "fill": (JPEG[:2] + b"\xff\xff\xff" + JPEG[2:], FrameInfo("jpeg", 160, 120)),
    "trailing": (JPEG + b"\0" * 100, FrameInfo("jpeg", 160, 120)),
    "two": (JPEG + JPEG, FrameInfo("jpeg", 160, 120)),
    "thumbnail": (JPEG[:2] + segment(0xE1, JPEG[:500]) + JPEG[2:], FrameInfo("jpeg", 160, 120)),
    "stray": (JPEG[:20] + b"stray" + JPEG[20:], FrameInfo("jpeg", 160, 120)),
    "stray-stuffed": (JPEG[:20] + b"\xff\0" * 9 + JPEG[20:], FrameInfo("jpeg", 160, 120)),
    "stray-restart": (JPEG[:20] + b"\xff\xd0\xff\x01" + JPEG[20:], FrameInfo("jpeg", 160, 120)),
    "trailer-in-place-of-the-end": (JPEG[:-2] + b"SEFT", FrameInfo("jpeg", 160, 120)),
    "png": (PNG, FrameInfo("png", 160, 120)),
    "grey-png": (encode(".png", picture(gray=True)), FrameInfo("png", 160, 120, gray=True)),
    "lossless": (WEBP, FrameInfo("webp", 160, 120)),
    "odd-lossless": (encode(".webp", picture(161, 121)), FrameInfo("webp", 161, 121)),
    "vp8x": (riff(vp8x(160, 120), WEBP[12:]), FrameInfo("webp", 160, 120)),
}


@pytest.mark.parametrize(("data", "info"), SOUND.values(), ids=SOUND)
def test_a_sound_header_is_read(data: bytes, info: FrameInfo) -> None:
    assert sniff(data) == info.kind
    assert inspect(data, LIMITS) == info


def test_a_lossy_webp_is_read() -> None:
    assert inspect(encode(".webp", picture(), 64, 80), LIMITS) == FrameInfo("webp", 160, 120)


@pytest.mark.parametrize("kind", ["jpeg", "png", "webp"])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("orientation", range(10))
def test_the_exif_orientation_swaps_the_sides(kind: str, order: str, orientation: int) -> None:
    info = inspect(images.oriented(kind, picture(), orientation, order), LIMITS)
    assert info.orientation == (orientation if 1 <= orientation <= 8 else 1)
    assert (info.width, info.height) == ((120, 160) if 5 <= orientation <= 8 else (160, 120))


@pytest.mark.parametrize(
    ("width", "height", "code"),
    [
        (0, 0, "frame-undecodable"),
        (0, 120, "frame-undecodable"),
        (160, 0, "frame-undecodable"),
        (1, 65535, "frame-too-large"),
        (65535, 1, "frame-too-large"),
        (65500, 65500, "frame-too-large"),
        (65535, 65535, "frame-too-large"),
        (32000, 32000, "frame-too-large"),
        (16000, 16000, "frame-too-large"),
        (8193, 1, "frame-too-large"),
        (3840, 2161, "frame-too-large"),
    ],
)
@pytest.mark.parametrize("kind", ["jpeg", "png", "webp"])
def test_the_declared_size_is_limited(kind: str, width: int, height: int, code: str) -> None:
    if kind == "webp" and not (0 < width <= 16384 and 0 < height <= 16384):
        return  # cannot be written
    data = {
        "jpeg": lambda: with_size(JPEG, width, height),
        "png": lambda: images.png_header(width, height),
        "webp": lambda: riff(vp8x(width, height), WEBP[12:]),
    }[kind]()
    assert refused(data) == code


def test_limits_are_inclusive() -> None:
    exact = FrameLimits(max_bytes=len(JPEG), max_pixels=160 * 120, max_side=160)
    assert inspect(JPEG, exact).width == 160
    assert refused(JPEG, FrameLimits(max_bytes=len(JPEG) - 1)) == "frame-too-large"
    assert refused(JPEG, FrameLimits(max_pixels=160 * 120 - 1)) == "frame-too-large"
    assert refused(JPEG, FrameLimits(max_side=159)) == "frame-too-large"


def test_a_small_canvas_with_a_large_image_is_refused() -> None:
    assert refused(riff(vp8x(16, 12), WEBP[12:])) == "frame-undecodable"


@pytest.mark.parametrize("marker", [0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF])
def test_unsupported_kinds_of_jpeg_are_refused(marker: int) -> None:
    assert refused(patched(JPEG, SOF + 1, marker)) == "frame-undecodable"


BROKEN_JPEG = {
    "12-bit": patched(JPEG, SOF + 4, 12),
    "2-components": patched(JPEG, SOF + 9, 2),
    "no-components": patched(JPEG, SOF + 9, 0),
    "two-headers": JPEG[:SOF] + JPEG[SOF : SOF + 19] + JPEG[SOF:],
    "short-segment": JPEG[:2] + b"\xff\xe0\x00\x01" + JPEG[2:],
    "many-segments": JPEG[:2] + segment(0xFE, b"") * 2000 + JPEG[2:],
    "no-header": JPEG[:SOF] + JPEG[JPEG.find(b"\xff\xda") :],
    "second-beginning": JPEG[:20] + JPEG,
    "end-first": JPEG[:20] + b"\xff\xd9" + JPEG[20:],
    "empty": b"\xff\xd8\xff\xd9",
    "magic-only": b"\xff\xd8\xff",
    "fill-only": b"\xff\xd8\xff\xff\xff",
}


@pytest.mark.parametrize("data", BROKEN_JPEG.values(), ids=BROKEN_JPEG)
def test_a_broken_jpeg_is_refused(data: bytes) -> None:
    assert refused(data) == "frame-undecodable"


BROKEN_PNG_AND_WEBP = {
    "apng": PNG[:33] + images.chunk(b"acTL", bytes(8)) + PNG[33:],
    "no-header": PNG[:8] + PNG[33:],
    "many-chunks": PNG[:33] + images.chunk(b"tEXt", b"") * 2000 + PNG[33:],
    "only-end": PNG[:8] + images.chunk(b"IEND", b""),
    "magic-only": PNG[:8],
    "animated": riff(vp8x(160, 120, 2), WEBP[12:]),
    "frames": riff(vp8x(160, 120), riff_chunk(b"ANMF", WEBP[12:])),
    "two-images": riff(WEBP[12:], WEBP[12:]),
    "canvas-only": riff(vp8x(160, 120)),
    "empty-riff": riff(),
    "vp8-inter-frame": riff(riff_chunk(b"VP8 ", b"\x01" + bytes(20))),
    "vp8l-signature": riff(riff_chunk(b"VP8L", bytes(20))),
    "many-riff": riff(riff_chunk(b"junk", b"") * 2000 + WEBP[12:]),
    "long-chunk": WEBP[:12] + WEBP[12:16] + b"\xff\xff\xff\x00" + WEBP[20:],
}


@pytest.mark.parametrize("data", BROKEN_PNG_AND_WEBP.values(), ids=BROKEN_PNG_AND_WEBP)
def test_a_broken_png_or_webp_is_refused(data: bytes) -> None:
    assert refused(data) == "frame-undecodable"


@pytest.mark.parametrize("name", SAMPLES)
def test_truncated(name: str) -> None:
    """A JPEG's coded data are found to end too early when they are read, all else by the header."""
    data = SAMPLES[name]
    for percent in range(1, 100):
        with pytest.raises(FrameError) as error:
            decode(data[: max(12, len(data) * percent // 100)], LIMITS)
        assert error.value.code == "frame-undecodable", percent


NOT_OURS = {
    "empty": b"",
    "zeros": b"\0" * 1000,
    "two-bytes": b"\xff\xd8",
    "bmp": encode(".bmp", picture()),
    "tiff": encode(".tiff", picture()),
    "gif": encode(".gif", picture()),
    "ppm": encode(".ppm", picture()),
    "jp2": encode(".jp2", picture()),
    "avif": b"\0\0\0\x1cftypavif\0\0\0\0avifmif1miafMA1A",
    "svg": b"<svg xmlns='http://www.w3.org/2000/svg'/>",
    "wav": b"RIFF\x04\0\0\0WAVE",
}


@pytest.mark.parametrize("data", NOT_OURS.values(), ids=NOT_OURS)
def test_other_formats_are_refused(data: bytes) -> None:
    assert sniff(data) is None
    assert refused(data) == "unsupported-image"


def test_scan_bomb() -> None:
    assert refused(images.scan_bomb(200)) == "frame-too-large"
    # An end of image that hides in a comment does not hide the scans that follow it.
    assert refused(images.scan_bomb(200, between=segment(0xFE, b"\xff\xd9"))) == "frame-too-large"
    assert refused(images.scan_bomb(200, between=b"\xff\x01")) == "frame-too-large"


def test_pixels_times_scans_are_bounded() -> None:
    """A camera's JPEG has one scan and is bounded by its pixels alone."""
    progressive = jpeg(*images.PROGRESSIVE)
    scans = progressive.count(b"\xff\xda")
    assert scans == 10
    exact = FrameLimits(max_scan_pixels=160 * 120 * scans)
    assert inspect(progressive, exact).width == 160
    assert refused(progressive, FrameLimits(max_scan_pixels=160 * 120 * scans - 1)) == "frame-too-large"
    assert inspect(JPEG, FrameLimits(max_scan_pixels=1)).width == 160
    # As it is set: 1080p in twelve scans, 4K in three.
    for width, height, scans in ((1920, 1080, 12), (3840, 2160, 3)):
        assert width * height * scans <= LIMITS.max_scan_pixels < width * height * (scans + 1)


def test_bytes_that_only_look_like_scans_pass() -> None:
    data = jpeg(*images.PROGRESSIVE)
    last = data.rfind(b"\xff\xda")
    comment = data[:last] + segment(0xFE, b"\xff\xda" * 100) + data[last:]
    assert inspect(comment, LIMITS).width == 160
    assert inspect(data + b"\xff\xda" * 100, LIMITS).width == 160
    assert inspect(JPEG[:-2] + b"\xff\xda" * 100 + JPEG[-2:], LIMITS).width == 160  # no further scan is read


def test_a_lying_exif_is_ignored() -> None:
    for tiff in (b"", b"II*\0", b"II*\0\xff\xff\xff\xff", b"II*\0\x08\0\0\0\xff\xff", images.exif(6)[:-9]):
        data = JPEG[:2] + segment(0xE1, b"Exif\0\0" + tiff) + JPEG[2:]
        assert inspect(data, LIMITS) == FrameInfo("jpeg", 160, 120)


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """A sound image with some bytes changed, cut or doubled."""
    data = bytearray(draw(st.sampled_from(sorted(SAMPLES.values()))))
    for _ in range(draw(st.integers(1, 8))):
        at = draw(st.integers(0, min(len(data), 700) - 1))
        match draw(st.integers(0, 3)):
            case 0:
                data[at] = draw(st.integers(0, 255))
            case 1:
                del data[at : at + draw(st.integers(1, 40))]
            case 2:
                data[at:at] = draw(st.binary(max_size=40))
            case _:
                data[at:at] = data[at : at + 400]
        if not data:
            break
    return bytes(data)


def never_anything_else(data: bytes) -> None:
    try:
        info = inspect(data, LIMITS)
    except FrameError:
        return
    assert 0 < info.width <= LIMITS.max_side
    assert 0 < info.height <= LIMITS.max_side


@given(damaged())
def test_fuzz_damaged(data: bytes) -> None:
    never_anything_else(data)


@given(st.sampled_from([b"\xff\xd8\xff", PNG[:8], PNG[:33], b"RIFF\xff\0\0\0WEBP", JPEG[:2]]), st.binary())
@example(b"\xff\xd8", b"\xff" * 100_000)
@example(b"\xff\xd8", b"\xff\xfe\0\2" * 25_000)
@example(jpeg(*images.PROGRESSIVE)[:-2], b"\xff\xda\0\2" * 25_000)
@example(jpeg(*images.PROGRESSIVE)[:-2], b"\xff" * 100_000)
@example(jpeg(*images.PROGRESSIVE)[:-2], b"\xff\xda" * 20 + b"\xff\xd0" * 50_000)
def test_fuzz_made_up(head: bytes, tail: bytes) -> None:
    never_anything_else(head + tail)


def test_reading_a_header_needs_neither_numpy_nor_opencv() -> None:
    code = "import sys, mfcmt_core.images; sys.exit(bool({'numpy', 'cv2'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
