"""Renders the frames of docs/examples/frames, for whoever tries the service and has no video at hand.

``.venv/bin/python .ci/example_frames.py`` writes them anew and prints the box in the first one.
"""

import sys
from pathlib import Path

import cv2

from mfcmt_core import synthetic

FRAMES = Path(__file__).resolve().parents[1] / "docs" / "examples" / "frames"
COUNT = 10
EVERY = 3
ENCODER = [cv2.IMWRITE_JPEG_QUALITY, 80]


def rendered() -> synthetic.Sequence:
    """Every third frame of the sample clip at a quarter of its size, without its noise, which would be most of them."""
    return synthetic.clip("sample", size=(320, 240), target=(42.0, 56.0), grain=0.0)


def main() -> None:
    FRAMES.mkdir(exist_ok=True)
    clip = rendered()
    size = 0
    for number in range(COUNT):
        path = FRAMES / f"{number + 1:04d}.jpg"
        cv2.imwrite(str(path), clip.frames[EVERY * number], ENCODER)
        size += path.stat().st_size
    box = ",".join(f"{value:.0f}" for value in clip.boxes[0])
    sys.stdout.write(f"{COUNT} frames, {size / 1e3:.0f} kB, box {box}\n")


if __name__ == "__main__":
    main()
