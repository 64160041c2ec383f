"""Keep a detector's box between its detections: the detector runs on few frames, the tracker on the others.

    python supervision_between.py clip.mp4

Prints a line a frame: frame,source,x1,y1,x2,y2,confidence. Needs supervision and mfcmt[video]. The detector here finds
the brightest spot. Put yours in its place: a function that returns ``supervision.Detections``, as from_ultralytics and
from_inference do.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import supervision as sv

from mfcmt_core import MFCMT
from mfcmt_core.adapters import xyxy
from mfcmt_core.video import VideoReader

EVERY = 10
LEAST_CONFIDENCE = 0.5
Detector = Callable[[np.ndarray], sv.Detections]


def brightest(frame: np.ndarray) -> sv.Detections:
    """Return the box around the brightest spot of a BGR frame, as a stand-in for a detector."""
    gray = cv2.GaussianBlur(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), (15, 15), 0)
    _, _, _, (x, y) = cv2.minMaxLoc(gray)
    side = max(16, min(frame.shape[:2]) // 6)
    box = np.array([[x - side / 2, y - side / 2, x + side / 2, y + side / 2]], np.float32)
    return sv.Detections(xyxy=box, confidence=np.ones(1, np.float32), class_id=np.zeros(1, int))


def follow(frames: Iterator[np.ndarray], detect: Detector) -> Iterator[tuple[str, sv.Detections]]:
    """Yield for each frame who found the object, and where. The detector is asked early where the tracker doubts."""
    tracker, since = MFCMT(), EVERY
    for frame in frames:
        since += 1
        if since >= EVERY and len(found := detect(frame)):
            best = found[[int(np.argmax(found.confidence))]]
            left, top, right, bottom = map(float, best.xyxy[0])
            tracker.init(frame, (left, top, right - left, bottom - top))
            since = 0
            yield "detector", best
        elif since > EVERY:
            yield "nobody", sv.Detections.empty()
        else:
            result = tracker.update(frame)
            kept = sv.Detections(xyxy=xyxy(result), confidence=np.array([result.confidence], np.float32))
            if result.confidence < LEAST_CONFIDENCE:
                since = EVERY
            yield "tracker", kept


def main(path: str) -> None:
    """Print who found the object in each frame of the video, and where."""
    frames = (frame.image for frame in VideoReader(Path(path)))
    for number, (source, found) in enumerate(follow(frames, brightest)):
        for box, confidence in zip(found.xyxy, found.confidence if found.confidence is not None else (), strict=True):
            print(number, source, *(f"{value:.1f}" for value in box), f"{confidence:.3f}", sep=",")


if __name__ == "__main__":
    main(sys.argv[1])
