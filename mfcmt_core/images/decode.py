"""Decode an encoded image to pixels."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import Any, cast

import cv2
import numpy as np
import numpy.typing as npt
import simplejpeg

from ..quiet import quiet
from .header import FrameError, FrameInfo, FrameLimits, Kind, inspect
from .mend import mend

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


def decode(data: bytes, limits: FrameLimits, *, turned: bool = True) -> tuple[Image, FrameInfo]:
    """Return the pixels and the header of one encoded JPEG, PNG or WebP image.

    Parameters
    ----------
    data : bytes
        The whole file.
    limits : FrameLimits
        Checked on the header, before any pixel is decoded.
    turned : bool, optional
        Apply the EXIF orientation.

    Returns
    -------
    image : ndarray of uint8, shape (H, W, 3) or (H, W)
        BGR, or gray if the image is stored gray; C-contiguous. 16 bits are reduced to 8, alpha is dropped.
    info : FrameInfo
        The header.

    Raises
    ------
    FrameError
        If the image is no such format, is beyond the limits, or is damaged. A damaged JPEG or PNG is refused even if
        a decoder could show part of it.
    """
    info = inspect(data, limits)
    try:
        image = _READ[info.kind](data, info)
    except (ValueError, MemoryError, cv2.error) as refused:
        raise FrameError("frame-undecodable", f"the {info.kind} image is damaged") from refused
    stored = (info.height, info.width) if info.orientation < 5 else (info.width, info.height)
    if image.shape[:2] != stored:
        raise FrameError("frame-undecodable", f"the {info.kind} image has another size than its header says")
    if turned and info.orientation != 1:
        image = _TURN[info.orientation](image)
    return image, info


def decode_plain(data: bytes, *, turned: bool = True) -> Image:
    """Return the BGR pixels of an image in a format that :func:`decode` refuses. Raises :class:`FrameError`."""
    try:
        return _opencv(data, cv2.IMREAD_COLOR if turned else cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except (ValueError, MemoryError, cv2.error) as refused:
        raise FrameError("frame-undecodable", "the image is damaged") from refused


def _jpeg(data: bytes, info: FrameInfo) -> Image:
    """Decode a JPEG whose picture is whole. If the decoder warns even after :func:`mend`, the image is damaged."""
    try:
        return _turbo(data, info)
    except ValueError:
        data = mend(data)
    try:
        return _turbo(data, info)
    except ValueError as refused:
        if "subsampling" not in str(refused):  # rare ones that TurboJPEG does not know
            raise
    return _stored(data, info)


def _turbo(data: bytes, info: FrameInfo) -> Image:
    if info.cmyk:
        return _cmyk(data)
    image: Image = simplejpeg.decode_jpeg(data, "GRAY" if info.gray else "BGR")
    return image.reshape(image.shape[:2]) if info.gray else image


def _cmyk(data: bytes) -> Image:
    """Decode Adobe's inverted CMYK, the only kind in use: multiply each of C, M and Y by K."""
    inks = simplejpeg.decode_jpeg(data, "CMYK")
    key = inks[:, :, 3]
    image = cv2.merge([cv2.multiply(inks[:, :, i], key, scale=1 / 255) for i in (2, 1, 0)])
    return cast(Image, image)


def _png(data: bytes, info: FrameInfo) -> Image:
    if not _sound(data):
        raise ValueError("checksum")
    return _stored(data, info)


def _stored(data: bytes, info: FrameInfo) -> Image:
    mode = cv2.IMREAD_GRAYSCALE if info.gray else cv2.IMREAD_COLOR
    return _opencv(data, mode | cv2.IMREAD_IGNORE_ORIENTATION)


def _opencv(data: bytes, mode: int) -> Image:
    with quiet():  # libpng, libtiff and OpenCV print warnings
        image = cv2.imdecode(np.frombuffer(data, np.uint8), mode)
    if image is None:
        raise ValueError("no image")
    return cast(Image, image)


def _sound(png: bytes) -> bool:
    """Return True if the checksums of all chunks are right. This takes 2 % of the decoding."""
    at, name = 8, b""
    while name != b"IEND":
        length, name = struct.unpack_from(">I4s", png, at)
        end = at + 8 + length
        if zlib.crc32(memoryview(png)[at + 4 : end]) != int.from_bytes(png[end : end + 4], "big"):
            return False
        at = end + 4
    return True


_READ: dict[Kind, Callable[[bytes, FrameInfo], Image]] = {"jpeg": _jpeg, "png": _png, "webp": _stored}
