"""Renders the page's sample clip, service/web/page/sample.webm, its first frame, sample.jpg, and box, sample.json.

For when the clip is to change: ``.venv/bin/pip install av && .venv/bin/python .ci/sample_clip.py``.
PyAV is no dependency of the project: OpenCV's video writer cannot bound the bit rate.
"""

import json
import sys
from fractions import Fraction
from pathlib import Path

import av
import cv2

from mfcmt_core import synthetic

PAGE = Path(__file__).resolve().parents[1] / "service" / "web" / "page"
FPS = 30
ENCODER = {"crf": "40", "b": "0", "deadline": "good", "cpu-used": "2"}


def main() -> None:
    clip = synthetic.clip("sample", grain=0.0)  # noise would be most of the file
    height, width = clip.frames[0].shape[:2]
    with av.open(str(PAGE / "sample.webm"), "w", options={"fflags": "+bitexact"}) as film:
        stream = film.add_stream("libvpx-vp9", rate=FPS, options=ENCODER)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.time_base = Fraction(1, FPS)
        stream.gop_size = 30  # so that stepping is quick
        for index, image in enumerate(clip.frames):
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            frame.pts, frame.time_base = index, Fraction(1, FPS)
            film.mux(stream.encode(frame))
        film.mux(stream.encode())
    cv2.imwrite(str(PAGE / "sample.jpg"), clip.frames[0], [cv2.IMWRITE_JPEG_QUALITY, 80])
    box = [round(float(value), 1) for value in clip.boxes[0]]
    told = {"fps": FPS, "frames": len(clip), "size": [width, height], "box": box}
    (PAGE / "sample.json").write_text(json.dumps(told) + "\n")
    sys.stdout.write(f"{len(clip)} frames, {(PAGE / 'sample.webm').stat().st_size / 1e3:.0f} kB, box {box}\n")


if __name__ == "__main__":
    main()
