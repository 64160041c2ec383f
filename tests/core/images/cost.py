"""What reading an image costs: ``python -m tests.core.images.cost``.

Milliseconds of processor time, the least of several rounds: camera JPEGs by size, decoded as the service does and by
the libraries alone, turn by turn; the same with stray bytes, which are mended; and the costliest images that the
limits let in.
"""

from __future__ import annotations

import time

import cv2
import numpy as np
import simplejpeg

from mfcmt_core import synthetic
from mfcmt_core.images import FrameLimits
from mfcmt_core.images.decode import decode
from tests.core import jpegs

SIZES = {"VGA": (640, 480), "720p": (1280, 720), "1080p": (1920, 1080)}
ROUNDS = 40
LIMITS = FrameLimits()


def least_ms(ways, data):
    """Return for each way to read ``data`` its least time over the rounds."""
    best = dict.fromkeys(ways, float("inf"))
    for _ in range(ROUNDS):
        for name, way in ways.items():
            begun = time.thread_time()
            way(data)
            best[name] = min(best[name], (time.thread_time() - begun) * 1e3)
    return best


def picture(size):
    """Return a rendered frame with sensor noise."""
    image = cv2.resize(synthetic.clip("sample").frames[0], size, interpolation=cv2.INTER_CUBIC)
    return cv2.add(image, np.random.default_rng(0).integers(0, 12, image.shape, dtype=np.uint8))


def main():
    ways = {"decode": lambda data: decode(data, LIMITS), "simplejpeg": lambda data: simplejpeg.decode_jpeg(data, "BGR")}
    ways["OpenCV"] = lambda data: cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    print(f"{'':28}{''.join(f'{name:>12}' for name in ways)}")
    for name, size in SIZES.items():
        image = picture(size)
        for kind, data in (
            ("camera", jpegs.encode(image)),
            ("restarts", jpegs.encode(image, cv2.IMWRITE_JPEG_RST_INTERVAL, size[0] // 16)),
        ):
            least = least_ms(ways, data)
            print(f"{name + ', ' + kind:28}{''.join(f'{least[way]:12.2f}' for way in ways)}")
        least = least_ms({"decode": ways["decode"]}, jpegs.before_restarts(data, b"\0"))
        print(f"{name + ', stray bytes':28}{least['decode']:12.2f}")
    for name, size, options in (
        ("4K, one scan", (3840, 2160), ()),
        ("4K, one scan, best quality", (3840, 2160), (cv2.IMWRITE_JPEG_QUALITY, 100)),
        ("1080p in 10 scans", (1920, 1080), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)),
    ):
        data = jpegs.encode(picture(size), *options)
        print(f"{name:28}{least_ms({'decode': ways['decode']}, data)['decode']:12.2f}")


if __name__ == "__main__":
    main()
