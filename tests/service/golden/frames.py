"""Paint the frames that the exchanges send: ``python -m tests.service.golden.frames``. They are kept as files."""

from __future__ import annotations

from pathlib import Path

import cv2

from mfcmt_core import synthetic

FRAMES = Path(__file__).parent / "frames"


def main() -> None:
    """Write five frames, in which a target moves a few pixels a frame, and print where it is."""
    sequence = synthetic.render(synthetic.Scene((160, 120), (30.0, 24.0), 40, speed=0.1, grain=2.0))
    FRAMES.mkdir(exist_ok=True)
    for number in range(5):
        data = cv2.imencode(".jpg", sequence.frames[number], [cv2.IMWRITE_JPEG_QUALITY, 85])[1]
        (FRAMES / f"{number}.jpg").write_bytes(data.tobytes())
        print([round(float(value), 1) for value in sequence.boxes[number]])  # noqa: T201


if __name__ == "__main__":
    main()
