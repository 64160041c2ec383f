"""Encoded images for the tests, sound and hostile."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import numpy.typing as npt


def picture(width: int = 160, height: int = 120, *, gray: bool = False) -> npt.NDArray[np.uint8]:
    """A smooth picture that no flip or turn maps onto itself."""
    y, x = np.mgrid[0:height, 0:width]
    planes = [x * 255 // width, y * 255 // height, (x + 2 * y) % 256]
    return planes[0].astype(np.uint8) if gray else np.dstack(planes).astype(np.uint8)


def encode(extension: str, image: npt.NDArray[np.uint8], *options: int) -> bytes:
    """``image`` as ``.jpg``, ``.png``, ``.webp``, ``.bmp`` ..."""
    done, data = cv2.imencode(extension, image, list(options))
    assert done
    return data.tobytes()


def jpeg(*options: int, width: int = 160, height: int = 120, gray: bool = False) -> bytes:
    return encode(".jpg", picture(width, height, gray=gray), *options)


PROGRESSIVE = (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)


def sof(data: bytes) -> int:
    """Where the frame header of a JPEG begins."""
    at = 2
    while data[at + 1] not in (0xC0, 0xC1, 0xC2):
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return at


def with_size(data: bytes, width: int, height: int) -> bytes:
    """A JPEG that declares another size."""
    at = sof(data) + 5
    return data[:at] + struct.pack(">HH", height, width) + data[at + 4 :]


def patched(data: bytes, at: int, value: int) -> bytes:
    return data[:at] + bytes([value]) + data[at + 1 :]


def scan_bomb(copies: int, *, between: bytes = b"", width: int = 3840, height: int = 2160) -> bytes:
    """A progressive JPEG whose last scan, of some 20 bytes, comes ``copies`` times again."""
    data = encode(".jpg", np.zeros((height, width), np.uint8), *PROGRESSIVE)
    last = data.rfind(b"\xff\xda")
    return data[:-2] + (between + data[last:-2]) * copies + data[-2:]


def segment(marker: int, body: bytes) -> bytes:
    return bytes([0xFF, marker]) + struct.pack(">H", len(body) + 2) + body


def exif(orientation: int, order: str = "<") -> bytes:
    """A TIFF block with an orientation and nothing else."""
    head = b"II*\0" if order == "<" else b"MM\0*"
    return head + struct.pack(order + "IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)


def oriented(kind: str, image: npt.NDArray[np.uint8], orientation: int, order: str = "<") -> bytes:
    """``image`` stored as it is, with an EXIF orientation beside it."""
    tiff = exif(orientation, order)
    if kind == "jpeg":
        data = encode(".jpg", image)
        return data[:2] + segment(0xE1, b"Exif\0\0" + tiff) + data[2:]
    if kind == "png":
        data = encode(".png", image)
        return data[:33] + chunk(b"eXIf", tiff) + data[33:]
    data = encode(".webp", image)
    height, width = image.shape[:2]
    return riff(vp8x(width, height, 8), data[12:], riff_chunk(b"EXIF", tiff))


def chunk(name: bytes, body: bytes) -> bytes:
    """One chunk of a PNG."""
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def png_header(width: int, height: int) -> bytes:
    """A PNG that says it is huge and holds next to nothing."""
    body = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = chunk(b"IDAT", zlib.compress(bytes(1000)))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", body) + data + chunk(b"IEND", b"")


def riff_chunk(name: bytes, body: bytes) -> bytes:
    return name + struct.pack("<I", len(body)) + body + bytes(len(body) & 1)


def vp8x(width: int, height: int, flags: int = 0) -> bytes:
    sizes = (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    return riff_chunk(b"VP8X", bytes([flags, 0, 0, 0]) + sizes)


def riff(*chunks: bytes) -> bytes:
    body = b"WEBP" + b"".join(chunks)
    return b"RIFF" + struct.pack("<I", len(body)) + body
