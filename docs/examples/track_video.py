"""Track boxes through a video file, a camera or a stream.

    python track_video.py clip.mp4 198,214,34,81                        each frame of a file
    python track_video.py rtsp://camera/stream 198,214,34,81 20,30,40,50  two targets, the newest frame of a live stream
    python track_video.py 0 198,214,34,81                               the first camera

Prints a line a target and frame: seq,target,x,y,w,h,status. SERVICE is the service's URL, KEY an API key. A stream that
is gone is tried again for RETRY seconds (60). Needs mfcmt[video].
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from mfcmt_core.video import LiveVideo, VideoError, VideoReader
from service.client import Client, ClientError, Region

JPEG_QUALITY = 80


def open_video(source: str) -> Iterator[np.ndarray]:
    """Yield the frames of a file or of a live source. Raises VideoError if frames are missing."""
    video: LiveVideo | VideoReader
    if is_live(source):
        retry_s = float(os.environ.get("RETRY", "60"))
        number_or_address = int(source) if source.isdigit() else source
        video = LiveVideo(number_or_address, retry_s=retry_s, tell=lambda line: print(line, file=sys.stderr))
    else:
        video = VideoReader(Path(source))
    return (frame.image for frame in video)


def is_live(source: str) -> bool:
    """Return True for a camera's number and for an address."""
    return source.isdigit() or "://" in source


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
    wanted = [[float(v) for v in box.split(",")] for box in boxes]
    video = open_video(source)
    first = next(video)
    missing: list[str] = []

    def rest() -> Iterator[np.ndarray]:
        try:
            yield from video
        except VideoError as failed:  # what has come until now is tracked all the same
            missing.append(str(failed))

    with (
        Client(os.environ.get("SERVICE", "http://127.0.0.1:8000"), key=os.environ.get("KEY")) as client,
        client.create(encode(first, None), boxes=wanted) as session,
        # A file waits for the tracker; a live source does not, so its older frames are dropped.
        session.stream(rest(), mode="latest" if is_live(source) else "lossless", encode=encode) as results,
    ):
        for result in results:
            for target in result.targets:
                x, y, w, h = target.box
                print(f"{result.seq},{target.id},{x:.2f},{y:.2f},{w:.2f},{h:.2f},{target.status}", flush=True)
    if missing:
        sys.exit(missing[0])


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit("python track_video.py SOURCE x,y,w,h [x,y,w,h ...]")
    try:
        main(*sys.argv[1:])
    except (ClientError, VideoError, ValueError) as failed:
        sys.exit(str(failed))
