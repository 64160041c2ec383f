"""Read image files for the command and the evaluation: without the limits of the service, always as BGR."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import cv2

from ..errors import MFCMTError
from .decode import Image, decode, decode_plain
from .header import FrameError, FrameLimits, sniff

SUFFIXES = frozenset(
    {".bmp", ".jfif", ".jpe", ".jpeg", ".jpg", ".pbm", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp"}
)
UNREADABLE_SUFFIXES = frozenset(
    {
        *(".arw", ".avif", ".cr2", ".cr3", ".dng", ".exr", ".gif", ".heic", ".heif", ".jp2", ".jxl", ".nef", ".orf"),
        *(".psd", ".raw", ".rw2", ".svg", ".tga"),
    }
)
"""Suffixes of images that cannot be read. They are refused and not skipped, or frames would be missing unnoticed."""

COMPANIONS = frozenset(
    {".csv", ".db", ".html", ".ini", ".json", ".mat", ".md", ".pdf", ".toml", ".txt", ".xml", ".yaml", ".yml"}
)
"""Suffixes of files that lie beside images, and need no word if they are left out."""

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


def natural_key(path: Path) -> list[int | str]:
    """Return a key that sorts files by the numbers in their names: ``img2.jpg`` before ``img10.jpg``."""
    return [int(part) if i % 2 else part for i, part in enumerate(re.split(r"([0-9]+)", path.name))]


def list_images(folder: Path, suffixes: Iterable[str] = SUFFIXES) -> list[Path]:
    """Return the image files of a folder, in the order of the numbers in their names.

    Files that a system hides (``._1.jpg``) are left out. There are none if the folder does not exist.
    """
    wanted = frozenset(suffixes)
    found = folder.iterdir() if folder.is_dir() else ()
    return sorted((f for f in found if f.suffix.lower() in wanted and not f.name.startswith(".")), key=natural_key)


def left_out(folder: Path) -> list[Path]:
    """Return the files of a folder that :func:`list_images` leaves out and that are no plain companions of images.

    Raises
    ------
    BadImageFile
        If one is an image of a format that cannot be read, since frames would be missing without it.
    """
    files = sorted((f for f in folder.iterdir() if f.is_file() and not f.name.startswith(".")), key=natural_key)
    refused = [file for file in files if file.suffix.lower() in UNREADABLE_SUFFIXES]
    if refused:
        more = f", like {len(refused) - 1} more" if len(refused) > 1 else ""
        raise BadImageFile(f"{refused[0]} is of a kind that cannot be read{more}: convert it to JPEG or PNG")
    return [file for file in files if file.suffix.lower() not in SUFFIXES | COMPANIONS]
