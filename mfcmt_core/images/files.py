"""Read image files for the command and the evaluation: without the limits of the service, always as BGR."""

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
"""Suffixes of images that cannot be read. They are refused and not skipped, or frames would be missing unnoticed."""

LIMITS = FrameLimits(max_bytes=1 << 31, max_pixels=1 << 30, max_side=1 << 20, max_scans=1000, max_scan_pixels=1 << 36)
_PLAIN = (b"BM", b"II*\0", b"MM\0*", *(b"P%d" % kind for kind in range(1, 7)))
"""First bytes of BMP, TIFF and the portable maps, which the command reads and the service does not."""


class BadImageFile(MFCMTError):
    """A file cannot be read as an image. The message names the file and the reason."""


def read_image(path: Path, *, turned: bool = True) -> Image:
    """Return the pixels of an image file.

    Parameters
    ----------
    path : Path
        A file of one of :data:`SUFFIXES`; its content decides on the format.
    turned : bool, optional
        Apply the EXIF orientation.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3)
        BGR, also for a gray image.

    Raises
    ------
    BadImageFile
        If the file is missing, damaged or of another format.
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
