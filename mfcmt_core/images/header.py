"""Read the header of an encoded image without decoding a pixel.

The readers step from segment to segment: a camera's JPEG takes a few microseconds, a progressive JPEG as long as the
search of its bytes for scans. They find the same header as the decoders, so that no image passes the limits here with
one size and is decoded with another.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import Literal, NoReturn

Kind = Literal["jpeg", "png", "webp"]
FrameCode = Literal["frame-too-large", "unsupported-image", "frame-undecodable"]


class FrameError(Exception):
    """An image is refused. ``code`` is a problem code of the protocol, ``detail`` a text for any reader."""

    def __init__(self, code: FrameCode, detail: str) -> None:
        super().__init__(detail)
        self.code = code
        self.detail = detail


@dataclass(frozen=True, slots=True)
class FrameLimits:
    """The limits of an encoded image: bytes, pixels, pixels per side, scans of a JPEG, and pixels times scans.

    Each scan of a JPEG goes through all pixels again, so a JPEG of several scans costs as much as several images. The
    last limit holds for these only; a camera writes one scan.
    """

    max_bytes: int = 8_000_000
    max_pixels: int = 3840 * 2160
    max_side: int = 8192
    max_scans: int = 16
    max_scan_pixels: int = 25_000_000


@dataclass(frozen=True, slots=True)
class FrameInfo:
    """The header of an image. ``width`` and ``height`` are those after the EXIF orientation is applied.

    ``orientation`` is EXIF's, 1–8. ``gray`` is True if the decoded image has one channel, ``cmyk`` if a JPEG is stored
    with four.
    """

    kind: Kind
    width: int
    height: int
    orientation: int = 1
    gray: bool = False
    cmyk: bool = False


# Largest number of segments or chunks in a header. To step through them takes well under a millisecond.
MAX_PARTS = 1024
MAX_EXIF_TAGS = 256
TAG_ORIENTATION = 0x0112

_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
_SOI, _EOI, _SOS, _APP1, _TEM = 0xD8, 0xD9, 0xDA, 0xE1, 0x01
# Baseline, extended and progressive: the Huffman-coded kinds, which all cameras and encoders write.
_SOF_BASELINE = (0xC0, 0xC1)
_SOF_PROGRESSIVE = 0xC2
_SOF_OTHER = {0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF}
# In coded data, FF is followed by 00 or a restart marker. Anything else begins the next segment.
_NEXT_MARKER = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")
# Between segments, all decoders skip restart markers and bytes that are no marker.
_NEXT_SEGMENT = re.compile(rb"\xff[^\x00\x01\xff\xd0-\xd7]")


def sniff(data: bytes | memoryview) -> Kind | None:
    """Return the format of the image that ``data`` begins with, or None."""
    head = bytes(data[:12])
    if head.startswith(b"\xff\xd8\xff"):
        return "jpeg"
    if head.startswith(_PNG_MAGIC):
        return "png"
    if head.startswith(b"RIFF") and head[8:] == b"WEBP":
        return "webp"
    return None


def inspect(data: bytes, limits: FrameLimits) -> FrameInfo:
    """Return the header of one encoded image. Raises :class:`FrameError` if it is damaged or beyond ``limits``."""
    if len(data) > limits.max_bytes:
        raise FrameError("frame-too-large", f"{len(data)} bytes; at most {limits.max_bytes}")
    kind = sniff(data)
    if kind is None:
        raise FrameError("unsupported-image", "not a JPEG, PNG or WebP image")
    try:
        if kind == "jpeg":
            return _jpeg(data, limits)
        return _png(data, limits) if kind == "png" else _webp(data, limits)
    except (struct.error, IndexError):
        _undecodable("the image ends within its header")


def _undecodable(detail: str) -> NoReturn:
    raise FrameError("frame-undecodable", detail)


def _measured(info: FrameInfo, limits: FrameLimits) -> FrameInfo:
    width, height = info.width, info.height
    if width == 0 or height == 0:
        _undecodable("the image has no pixels")
    if max(width, height) > limits.max_side or width * height > limits.max_pixels:
        raise FrameError(
            "frame-too-large",
            f"{width}x{height} pixels; at most {limits.max_pixels} pixels and {limits.max_side} a side",
        )
    return info


def _oriented(
    kind: Kind, width: int, height: int, orientation: int, *, gray: bool = False, cmyk: bool = False
) -> FrameInfo:
    if orientation >= 5:
        width, height = height, width
    return FrameInfo(kind, width, height, orientation, gray, cmyk)


def _exif_orientation(tiff: bytes) -> int:
    """Return the orientation in IFD0 of a TIFF block, or 1 if it is absent or invalid."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(tiff[:4])
    if order is None:
        return 1
    try:
        (at,) = struct.unpack_from(order + "I", tiff, 4)
        (count,) = struct.unpack_from(order + "H", tiff, at)
        for entry in range(at + 2, at + 2 + 12 * min(count, MAX_EXIF_TAGS), 12):
            tag, kind, _, value = struct.unpack_from(order + "HHIH", tiff, entry)
            if tag == TAG_ORIENTATION:
                return value if kind == 3 and 1 <= value <= 8 else 1
    except struct.error:
        pass
    return 1


def _jpeg(data: bytes, limits: FrameLimits) -> FrameInfo:
    frame: tuple[int, int, int, int] | None = None  # SOF marker, height, width, components
    orientation = 0
    at = 2
    for _ in range(MAX_PARTS):
        found = _NEXT_SEGMENT.search(data, at)
        if found is None:
            _undecodable("the JPEG has no image data")
        at = found.start()
        marker = data[at + 1]
        if marker in (_SOI, _EOI):
            _undecodable("the JPEG has no image data")
        length = data[at + 2] << 8 | data[at + 3]
        if length < 2:
            _undecodable("a segment of the JPEG is broken")
        if marker in _SOF_BASELINE or marker == _SOF_PROGRESSIVE:
            if frame is not None:
                _undecodable("the JPEG has two frame headers")
            precision, height, width, components = struct.unpack_from(">BHHB", data, at + 4)
            if precision != 8:
                _undecodable(f"a JPEG of {precision} bits is not supported")
            if components not in (1, 3, 4):
                _undecodable(f"a JPEG of {components} components is not supported")
            frame = marker, height, width, components
        elif marker in _SOF_OTHER:
            _undecodable("arithmetic, lossless and hierarchical JPEG are not supported")
        elif marker == _APP1 and not orientation and data.startswith(b"Exif\0\0", at + 4):
            orientation = _exif_orientation(data[at + 10 : at + 2 + length])
        elif marker == _SOS:
            break
        at += 2 + length
    else:
        _undecodable("the JPEG has too many segments")
    if frame is None:
        _undecodable("the JPEG has no frame header")
    sof, height, width, components = frame
    info = _oriented("jpeg", width, height, orientation or 1, gray=components == 1, cmyk=components == 4)
    _measured(info, limits)
    # A sequential image whose first scan holds all components has no further scan; libjpeg would refuse it.
    if sof == _SOF_PROGRESSIVE or data[at + 4] < components:
        most = min(limits.max_scans, limits.max_scan_pixels // (width * height))
        if _too_many_scans(data, at, most):
            raise FrameError(
                "frame-too-large",
                f"more than {most} scans in a JPEG of {width}x{height} pixels; at most {limits.max_scans} scans"
                f" and {limits.max_scan_pixels} pixels times scans",
            )
    return info


def _too_many_scans(data: bytes, at: int, most: int) -> bool:
    """Return True if more than ``most`` scans begin at or after the SOS marker at ``at``."""
    # Every scan begins with these two bytes, so their number is an upper bound, found at memory speed. Only above
    # it the segments are walked, which tells tables and comments from scans and stops at EOI.
    if data.count(b"\xff\xda", at) <= most:
        return False
    scans = parts = 0
    while parts < MAX_PARTS:
        parts += 1
        found = _NEXT_MARKER.search(data, at)
        if found is None or data[found.start() + 1] == _EOI:
            return False
        at = found.end()
        if data[at - 1] == _SOS:
            scans += 1
            if scans > most:
                return True
        if data[at - 1] != _TEM:
            at += max(2, data[at] << 8 | data[at + 1])
    return True


def _png(data: bytes, limits: FrameLimits) -> FrameInfo:
    orientation = 0
    header: tuple[int, int, int] | None = None  # width, height, color type
    at = len(_PNG_MAGIC)
    for _ in range(MAX_PARTS):
        length, name = struct.unpack_from(">I4s", data, at)
        if at + 12 + length > len(data):
            _undecodable("the PNG is truncated")
        if header is None:
            if name != b"IHDR" or length != 13:
                _undecodable("the PNG does not begin with its header")
            width, height, _, color_type = struct.unpack_from(">IIBB", data, at + 8)
            header = width, height, color_type
            _measured(FrameInfo("png", width, height), limits)
        elif name == b"acTL":
            _undecodable("the PNG is animated")
        elif name == b"eXIf" and not orientation:
            orientation = _exif_orientation(data[at + 8 : at + 8 + length])
        elif name == b"IEND":
            break
        at += 12 + length
    else:
        _undecodable("the PNG has too many chunks")
    if header is None:
        _undecodable("the PNG has no header")
    width, height, color_type = header
    return _oriented("png", width, height, orientation or 1, gray=color_type in (0, 4))


def _webp(data: bytes, limits: FrameLimits) -> FrameInfo:
    end = 8 + int.from_bytes(data[4:8], "little")
    if end > len(data):
        _undecodable("the WebP is truncated")
    orientation = 0
    size: tuple[int, int] | None = None
    canvas: tuple[int, int] | None = None
    at = 12
    for _ in range(MAX_PARTS):
        if at + 8 > end:
            break
        name, length = struct.unpack_from("<4sI", data, at)
        body = at + 8
        if body + length > end:
            _undecodable("the WebP is truncated")
        if name in (b"ANIM", b"ANMF") or (name == b"VP8X" and data[body] & 2):
            _undecodable("the WebP is animated")
        if name == b"VP8X":
            canvas = (
                1 + int.from_bytes(data[body + 4 : body + 7], "little"),
                1 + int.from_bytes(data[body + 7 : body + 10], "little"),
            )
            _measured(FrameInfo("webp", *canvas), limits)
        elif name in (b"VP8 ", b"VP8L"):
            if size is not None:
                _undecodable("the WebP holds two images")
            size = _vp8_size(data, body) if name == b"VP8 " else _vp8l_size(data, body)
            _measured(FrameInfo("webp", *size), limits)
        elif name == b"EXIF" and not orientation:
            exif = data[body : body + length]
            orientation = _exif_orientation(exif.removeprefix(b"Exif\0\0"))
        at = body + length + (length & 1)
    else:
        _undecodable("the WebP has too many chunks")
    if size is None:
        _undecodable("the WebP has no image data")
    if canvas is not None and canvas != size:
        _undecodable("the image of the WebP has another size than its canvas")
    return _oriented("webp", *size, orientation or 1)


def _vp8_size(data: bytes, at: int) -> tuple[int, int]:
    if data[at] & 1 or data[at + 3 : at + 6] != b"\x9d\x01\x2a":
        _undecodable("the WebP does not begin with a key frame")
    width, height = struct.unpack_from("<HH", data, at + 6)
    return width & 0x3FFF, height & 0x3FFF


def _vp8l_size(data: bytes, at: int) -> tuple[int, int]:
    if data[at] != 0x2F:
        _undecodable("the lossless WebP has no signature")
    bits = int.from_bytes(data[at + 1 : at + 5], "little")
    return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
