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
from .excerpt import Rect, excerpt
from .header import FrameError, FrameInfo, FrameLimits, Kind, inspect
from .mend import mend

Image = npt.NDArray[np.uint8]

MARGIN = 40
"""Pixels that an excerpt has beyond what is needed, on both sides together: two units and a half."""
LEAST_SAVED = 100_000
"""Pixels that must be left out for an excerpt to pay."""
MOST_NEEDED = 0.6
"""Largest part of a picture of which an excerpt pays."""

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
    return decode_inspected(data, info, turned=turned), info


def decode_part(data: bytes, info: FrameInfo, needed: Rect) -> tuple[Image, tuple[int, int]]:
    """Return the pixels of an image that are needed, or all of them, and where the first of them lies in the image.

    Parameters
    ----------
    data : bytes
        The whole file.
    info : FrameInfo
        What :func:`inspect` returned for it.
    needed : (int, int, int, int)
        ``(x, y, w, h)`` in pixels of the turned image, inside it.

    Returns
    -------
    image : ndarray of uint8, shape (H, W, 3) or (H, W)
        Pixels as those of :func:`decode`, bit for bit.
    offset : (int, int)
        Where its first pixel lies (x, y): that of ``needed``, or (0, 0) if the image is whole.

    Raises
    ------
    FrameError
        If the image is damaged, be it in the part that is needed or elsewhere.
    """
    if info.kind == "jpeg" and _pays(info, needed) and (part := _jpeg_part(data, info, needed)) is not None:
        return part, needed[:2]
    return decode_inspected(data, info), (0, 0)


def decode_inspected(data: bytes, info: FrameInfo, *, turned: bool = True) -> Image:
    """Return the pixels of an image whose header :func:`inspect` has read. Raises FrameError as :func:`decode` does."""
    try:
        image = _READ[info.kind](data, info)
    except (ValueError, MemoryError, cv2.error) as refused:
        raise FrameError("frame-undecodable", f"the {info.kind} image is damaged") from refused
    stored = (info.height, info.width) if info.orientation < 5 else (info.width, info.height)
    if image.shape[:2] != stored:
        raise FrameError("frame-undecodable", f"the {info.kind} image has another size than its header says")
    if turned and info.orientation != 1:
        image = _TURN[info.orientation](image)
    return image


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


def _pays(info: FrameInfo, needed: Rect) -> bool:
    """Return True if to decode an excerpt with ``needed`` costs clearly less than the whole picture."""
    whole, part = info.width * info.height, (needed[2] + MARGIN) * (needed[3] + MARGIN)
    return whole - part >= LEAST_SAVED and part <= MOST_NEEDED * whole


def _jpeg_part(data: bytes, info: FrameInfo, needed: Rect) -> Image | None:
    """Return the pixels of ``needed``, or None if the picture must be decoded as a whole."""
    x, y, w, h = _stored_rect(info, needed)
    found = excerpt(data, (x, y, w, h))
    if found is None:
        return None
    small, (left, top) = found
    try:
        image = _turbo(small, info)[top : top + h, left : left + w]
    except ValueError:  # the decoder warns about the header
        return None
    if image.shape[:2] != (h, w):
        return None
    return image if info.orientation == 1 else cast(Image, _TURN[info.orientation](image))


def _stored_rect(info: FrameInfo, rect: Rect) -> Rect:
    """Return where the pixels of ``rect`` in the turned image are stored."""
    x, y, w, h = rect
    from_right, from_bottom = info.width - x - w, info.height - y - h
    return {
        1: (x, y, w, h),
        2: (from_right, y, w, h),
        3: (from_right, from_bottom, w, h),
        4: (x, from_bottom, w, h),
        5: (y, x, h, w),
        6: (y, from_right, h, w),
        7: (from_bottom, from_right, h, w),
        8: (from_bottom, x, h, w),
    }[info.orientation]


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
