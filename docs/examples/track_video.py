"""Track boxes through whatever OpenCV reads: a video file, a camera, an RTSP stream.

    python track_video.py clip.mp4 198,214,34,81                        each frame of a file
    python track_video.py rtsp://camera/stream 198,214,34,81 20,30,40,50  two targets, the newest frame of a live stream
    python track_video.py 0 198,214,34,81                               the first camera

Prints a line a target and frame: seq,target,x,y,w,h,status. SERVICE is the service's URL, KEY an API key.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator

import cv2
import numpy as np

from service.client import Client, ClientError, Region

JPEG_QUALITY = 80


def frames(video: cv2.VideoCapture) -> Iterator[np.ndarray]:
    """Yield the remaining frames of the video."""
    while True:
        there, frame = video.read()
        if not there:
            return
        yield frame


def encode(frame: np.ndarray, region: Region | None) -> bytes:
    """Return the region of the frame that the trackers need, as JPEG: less to send and to decode."""
    if region is not None:
        x, y, w, h = region
        frame = frame[y : y + h, x : x + w]
    done, data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    assert done
    return data.tobytes()


def main(source: str, *boxes: str) -> None:
    """Track ``boxes`` (``x,y,w,h`` in the first frame) until the source ends."""
    live = source.isdigit() or "://" in source
    wanted = [[float(v) for v in box.split(",")] for box in boxes]
    video = cv2.VideoCapture(int(source) if source.isdigit() else source)
    there, first = video.read()
    if not there:
        sys.exit(f"no frame in {source}")
    with (
        Client(os.environ.get("SERVICE", "http://127.0.0.1:8000"), key=os.environ.get("KEY")) as client,
        client.create(encode(first, None), boxes=wanted) as session,
        # A file waits for the tracker; a live source does not, so its older frames are dropped.
        session.stream(frames(video), mode="latest" if live else "lossless", encode=encode) as results,
    ):
        for result in results:
            for target in result.targets:
                x, y, w, h = target.box
                print(f"{result.seq},{target.id},{x:.2f},{y:.2f},{w:.2f},{h:.2f},{target.status}", flush=True)
    if live:
        sys.exit(f"{source} gives no more frames")  # a camera has no end of its own


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit("python track_video.py SOURCE x,y,w,h [x,y,w,h ...]")
    try:
        main(*sys.argv[1:])
    except (ClientError, ValueError) as failed:
        sys.exit(str(failed))
