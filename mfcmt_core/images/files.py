"""Image files, as the command and the evaluation read them: without the service's limits, always BGR."""

from __future__ import annotations

from pathlib import Path

import cv2

from ..errors import MFCMTError
from .decode import Image, decode, decode_plain
from .header import FrameError, FrameLimits, sniff

SUFFIXES = frozenset(
    {".bmp", ".jfif", ".jpe", ".jpeg", ".jpg", ".pbm", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp"}
)
UNREADABLE_SUFFIXES = frozenset({".avif", ".dng", ".gif", ".heic", ".heif", ".jp2", ".jxl"})
"""Pictures that cannot be read. Among others they must not be passed over: the frames would be out of step."""

LIMITS = FrameLimits(max_bytes=1 << 31, max_pixels=1 << 30, max_side=1 << 20, max_scans=1000, max_scan_pixels=1 << 36)
_PLAIN = (b"BM", b"II*\0", b"MM\0*", *(b"P%d" % kind for kind in range(1, 7)))
"""How BMP, TIFF and the portable maps begin: files that a folder may hold and the service does not take."""


class BadImageFile(MFCMTError):
    """The file cannot be read as an image; the message names it and says why."""


def read_image(path: Path, *, turned: bool = True) -> Image:
    """The BGR pixels ``(H, W, 3)`` of an image file, as EXIF says that it is turned, unless ``turned`` is False.

    Raises BadImageFile.
    """
    try:
        data = path.read_bytes()
        if sniff(data) is None and data.startswith(_PLAIN):
            return decode_plain(data, turned=turned)
        image, _ = decode(data, LIMITS, turned=turned)
    except OSError as failed:
        raise BadImageFile(f"cannot read {path}: {failed.strerror or failed}") from failed
    except FrameError as refused:
        raise BadImageFile(f"cannot read {path}: {refused.detail}") from refused
    return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image  # type: ignore[return-value]
