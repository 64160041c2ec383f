"""An encoded frame to pixels; only lanes import this."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import Any, cast

import cv2
import numpy as np
import numpy.typing as npt
import simplejpeg

from .header import FrameError, FrameInfo, FrameLimits, Kind, inspect

Image = npt.NDArray[np.uint8]

_TURN: dict[int, Callable[[Image], Any]] = {
    2: lambda image: cv2.flip(image, 1),
    3: lambda image: cv2.rotate(image, cv2.ROTATE_180),
    4: lambda image: cv2.flip(image, 0),
    5: cv2.transpose,
    6: lambda image: cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE),
    7: lambda image: cv2.rotate(cv2.transpose(image), cv2.ROTATE_180),
    8: lambda image: cv2.rotate(image, cv2.ROTATE_90_COUNTERCLOCKWISE),
}


def decode(data: bytes, limits: FrameLimits) -> tuple[Image, FrameInfo]:
    """The pixels of one encoded image, with its EXIF orientation applied, and its header.

    The image is ``uint8``, C-contiguous: BGR of shape ``(H, W, 3)``, or ``(H, W)`` when it is stored grey.
    16 bits are reduced to 8, alpha is dropped. Raises :class:`FrameError` and nothing else: header limits
    are checked before any pixel, and a damaged JPEG or PNG is refused even where a picture could be made.
    """
    info = inspect(data, limits)
    try:
        image = _READ[info.kind](data, info)
    except (ValueError, MemoryError, cv2.error) as refused:
        raise FrameError("frame-undecodable", f"the {info.kind} image is damaged") from refused
    if info.orientation != 1:
        image = _TURN[info.orientation](image)
    if image.shape[:2] != (info.height, info.width):
        raise FrameError("frame-undecodable", f"the {info.kind} image is not of its header's size")
    return image, info


def _jpeg(data: bytes, info: FrameInfo) -> Image:
    if info.cmyk:
        return _cmyk(data)
    image: Image = simplejpeg.decode_jpeg(data, "GRAY" if info.grey else "BGR")
    return image.reshape(image.shape[:2]) if info.grey else image


def _cmyk(data: bytes) -> Image:
    """Adobe's inverted CMYK (the only kind in use): each of C, M, Y times K."""
    inks = simplejpeg.decode_jpeg(data, "CMYK")
    key = inks[:, :, 3]
    image = cv2.merge([cv2.multiply(inks[:, :, i], key, scale=1 / 255) for i in (2, 1, 0)])
    return cast(Image, image)


def _png(data: bytes, info: FrameInfo) -> Image:
    if not _sound(data):
        raise ValueError("checksum")
    return _opencv(data, info)


def _opencv(data: bytes, info: FrameInfo) -> Image:
    mode = cv2.IMREAD_GRAYSCALE if info.grey else cv2.IMREAD_COLOR
    image = cv2.imdecode(np.frombuffer(data, np.uint8), mode | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise ValueError("no image")
    return cast(Image, image)


def _sound(png: bytes) -> bool:
    """Whether all chunks carry their checksum (2 % of the decoding; libpng would complain to stderr)."""
    at, name = 8, b""
    while name != b"IEND":
        length, name = struct.unpack_from(">I4s", png, at)
        end = at + 8 + length
        if zlib.crc32(memoryview(png)[at + 4 : end]) != int.from_bytes(png[end : end + 4], "big"):
            return False
        at = end + 4
    return True


_READ: dict[Kind, Callable[[bytes, FrameInfo], Image]] = {"jpeg": _jpeg, "png": _png, "webp": _opencv}
