"""JPEGs as people's devices write them: an encoder for any sampling, and what cameras and phones do to a good JPEG."""

from __future__ import annotations

import re
import struct

import cv2
import numpy as np
import simplejpeg

# The order in which a block's coefficients are coded.
ZIGZAG = sorted(range(64), key=lambda i: (i // 8 + i % 8, i // 8 if (i // 8 + i % 8) % 2 else i % 8))
STRAY = {"zeros": b"\0\0\0", "text": b"stray bytes", "stuffed": b"\x12\xff\x00\x34", "long": bytes(range(255)) * 3}


def picture(width=160, height=120):
    """Return a BGR picture with edges and texture."""
    y, x = np.mgrid[0:height, 0:width]
    planes = [128 + 90 * np.sin(x / 9) * np.cos(y / 13), 255 * x / width, 40 + 160 * ((x // 12 + y // 10) % 2)]
    return np.dstack(planes).clip(0, 255).astype(np.uint8)


def encode(image, *options):
    """Return a JPEG as OpenCV writes it."""
    return cv2.imencode(".jpg", image, list(options))[1].tobytes()


def plain(*options):
    return encode(picture(), *options)


def with_restarts(units=3, *options):
    """Return a JPEG with a restart marker after every few units."""
    return plain(cv2.IMWRITE_JPEG_RST_INTERVAL, units, *options)


def progressive(*options):
    return plain(cv2.IMWRITE_JPEG_PROGRESSIVE, 1, *options)


def segments(data):
    """Return (start, marker) of each segment before the coded data, and where those begin."""
    found, at = [], 2
    while True:
        found.append((at, data[at + 1]))
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        if found[-1][1] == 0xDA:
            return found, at


def at_marker(data, marker):
    return next(at for at, found in segments(data)[0] if found == marker)


def insert(data, at, more):
    return data[:at] + more + data[at:]


def segment(marker, body):
    return bytes([0xFF, marker]) + struct.pack(">H", len(body) + 2) + body


def restarts(data):
    """Return the positions of the restart markers."""
    return [found.start() for found in re.finditer(rb"\xff[\xd0-\xd7]", data)]


def before_restarts(data, more, every=1):
    """Insert stray bytes before restart markers, as the C270 and IP cameras do."""
    for at in reversed(restarts(data)[::every]):
        data = insert(data, at, more)
    return data


def before_end(data, more):
    return data[:-2] + more + data[-2:]


def without_end(data, trailer=b""):
    """Replace the end by a vendor's trailer."""
    return data[:-2] + trailer


def between_segments(data, more, marker=None):
    """Insert stray bytes before one segment, or before each but the first."""
    for at, found in reversed(segments(data)[0][1:]):
        if marker in (None, found):
            data = insert(data, at, more)
    return data


def with_jfif(data, major, minor):
    at = at_marker(data, 0xE0)
    return data[: at + 9] + bytes([major, minor]) + data[at + 11 :]


def with_scan_parameters(data, first, last, bits):
    _, at = segments(data)
    return data[: at - 3] + bytes([first, last, bits]) + data[at:]


def without_tables(data):
    """Remove the Huffman tables, as in frames of a camera's video."""
    kept, at = [data[:2]], 2
    for at, marker in segments(data)[0]:
        end = at + 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        if marker != 0xC4:
            kept.append(data[at:end])
    return b"".join(kept) + data[segments(data)[1] :]


def damaged_icc():
    return segment(0xE2, b"ICC_PROFILE\0\x02\x01" + bytes(40))


def adobe(transform):
    return segment(0xEE, b"Adobe\0\x64\0\0\0\0" + bytes([transform]))


def parts(length, each):
    """Return how many parts of size ``each`` cover ``length``."""
    return -(-length // each)


class Bits:
    """Return bits as the bytes of a scan, with stuffing."""

    def __init__(self):
        self.text = []

    def add(self, value, count):
        if count:
            self.text.append(format(value, f"0{count}b"))

    def bytes(self):
        text = "".join(self.text)
        text += "1" * (-len(text) % 8)
        return int(text or "1" * 8, 2).to_bytes(max(len(text), 8) // 8, "big").replace(b"\xff", b"\xff\0")


def standard_tables():
    """Return the DHT segments of the standard's tables, and code and length by (kind, slot) and symbol."""
    data, codes, raw = simplejpeg.encode_jpeg(np.zeros((8, 8, 3), np.uint8)), {}, b""
    for at, marker in segments(data)[0]:
        if marker == 0xC4:
            end = at + 2 + int.from_bytes(data[at + 2 : at + 4], "big")
            raw += data[at:end]
            body, code, place = data[at + 4 : end], 0, 17
            for length in range(1, 17):
                for _ in range(body[length]):
                    codes[body[0] >> 4, body[0] & 15, body[place]] = (code, length)
                    code, place = code + 1, place + 1
                code <<= 1
    return raw, codes


QUANTUM = 4
"""By which every coefficient is divided."""


def code_block(bits, codes, coefficients, kind, before):
    """Add a block of coefficients to ``bits``, by the tables of ``kind``. Return its DC value, the next ``before``."""
    values = [round(float(coefficients.flat[i]) / QUANTUM) for i in ZIGZAG]
    dc, zeros = values[0], 0
    for index, value in enumerate([dc - before, *values[1:]]):
        if index and value == 0:
            zeros += 1
            continue
        while zeros > 15:
            bits.add(*codes[1, kind, 0xF0])
            zeros -= 16
        size = abs(value).bit_length()
        bits.add(*codes[int(index > 0), kind, zeros << 4 | size])
        bits.add(value if value > 0 else value + (1 << size) - 1, size)
        zeros = 0
    if zeros:
        bits.add(*codes[1, kind, 0])
    return dc


def units(scan, factors, size):
    """Yield the blocks of each unit of a scan as ``(component, row, column)``; ``size`` is (width, height)."""
    most_across, most_down = (max(sides) for sides in zip(*factors, strict=True))
    if len(factors) > 1 and len(scan) > 1:
        columns, rows = parts(size[0], 8 * most_across), parts(size[1], 8 * most_down)
        for y in range(rows):
            for x in range(columns):
                yield [
                    (c, y * factors[c][1] + j, x * factors[c][0] + i)
                    for c in scan
                    for j in range(factors[c][1])
                    for i in range(factors[c][0])
                ]
        return
    c = scan[0]
    h, v = factors[c] if len(factors) > 1 else (most_across, most_down)
    across, down = parts(parts(size[0] * h, most_across), 8), parts(parts(size[1] * v, most_down), 8)
    yield from ([(c, y, x)] for y in range(down) for x in range(across))


def written(image, factors, *, interleaved=True, restart=0):
    """Return a baseline JPEG of a gray or BGR image. ``factors`` has the sampling (across, down) per component."""
    planes = [image] if image.ndim == 2 else [cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)[..., c] for c in (0, 2, 1)]
    height, width = image.shape[:2]
    most_across, most_down = max(h for h, _ in factors), max(v for _, v in factors)
    raw, codes = standard_tables()
    columns, rows = parts(width, 8 * most_across), parts(height, 8 * most_down)
    blocks = []
    for plane, (h, v) in zip(planes, factors, strict=True):
        w, t = parts(width * h, most_across), parts(height * v, most_down)
        small = cv2.resize(plane, (w, t), interpolation=cv2.INTER_AREA).astype(np.float32) - 128
        full = cv2.copyMakeBorder(small, 0, rows * v * 8 - t, 0, columns * h * 8 - w, cv2.BORDER_REPLICATE)
        blocks.append(
            [
                [cv2.dct(full[y : y + 8, x : x + 8]) for x in range(0, full.shape[1], 8)]
                for y in range(0, full.shape[0], 8)
            ]
        )

    out = b"\xff\xd8" + segment(0xE0, b"JFIF\0\x01\x01\0\0\x01\0\x01\0\0")
    out += segment(0xDB, b"\0" + bytes([QUANTUM]) * 64)
    frame = b"".join(bytes([c + 1, h << 4 | v, 0]) for c, (h, v) in enumerate(factors))
    out += segment(0xC0, struct.pack(">BHHB", 8, height, width, len(planes)) + frame) + raw
    if restart:
        out += segment(0xDD, struct.pack(">H", restart))
    scans = [list(range(len(planes)))] if interleaved else [[c] for c in range(len(planes))]
    for scan in scans:
        out += segment(
            0xDA, bytes([len(scan)]) + b"".join(bytes([c + 1, 0x11 if c else 0]) for c in scan) + b"\0\x3f\0"
        )
        bits, before, number = Bits(), dict.fromkeys(scan, 0), 0
        for index, unit in enumerate(units(scan, factors, (width, height))):
            if restart and index and index % restart == 0:
                out += bits.bytes() + bytes([0xFF, 0xD0 + number % 8])
                bits, before, number = Bits(), dict.fromkeys(scan, 0), number + 1
            for c, y, x in unit:
                before[c] = code_block(bits, codes, blocks[c][y][x], min(c, 1), before[c])
        out += bits.bytes()
    return out + b"\xff\xd9"
