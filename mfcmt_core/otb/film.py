"""Frames of a sequence with the boxes of several trackers drawn in: a strip as in figure 1, or a video."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np

from ..errors import DataError
from ..video import VideoError
from ..video.write import VideoWriter
from .dataset import Image, Sequence
from .document import PALETTE
from .metrics import Array

STRIP_COLUMNS = 3
STRIP_WIDTH = 400
"""Pixels of a frame in a strip."""
LEGEND_HEIGHT = 26
FONT = cv2.FONT_HERSHEY_SIMPLEX
TRUTH = (255, 255, 255)


def strip(sequence: Sequence, boxes: Mapping[str, Array], frames: int = 6) -> Image:
    """Return evenly spread frames side by side, the truth in white, each tracker in its own color; BGR.

    ``boxes`` are ``(N, 4)``, 0-based, by tracker.
    """
    indices = np.linspace(0, len(sequence) - 1, frames + 1).round().astype(int)[1:]
    drawn = [_drawn(sequence, int(i), boxes, STRIP_WIDTH) for i in indices]
    blank = np.zeros_like(drawn[0])
    drawn += [blank] * (-len(drawn) % STRIP_COLUMNS)
    rows = [np.hstack(drawn[i : i + STRIP_COLUMNS]) for i in range(0, len(drawn), STRIP_COLUMNS)]
    return np.vstack([*rows, *_legend(list(boxes), rows[0].shape[1])])


def video(path: Path, sequence: Sequence, boxes: Mapping[str, Array], fps: float = 30.0) -> None:
    """Write every frame with its boxes as MP4. Raises DataError if it cannot be written."""
    try:
        writer = VideoWriter(path, fps)
        try:
            for index, image in enumerate(_film(sequence, boxes)):
                writer.write(image, index / fps)
        finally:
            writer.close()
    except VideoError as failed:
        raise DataError(str(failed)) from failed


def _film(sequence: Sequence, boxes: Mapping[str, Array]) -> Iterator[Image]:
    width = max(320, sequence.read(0).shape[1])
    legend = _legend(list(boxes), width)
    for index in range(len(sequence)):
        yield np.vstack([_drawn(sequence, index, boxes, width), *legend])


def _drawn(sequence: Sequence, index: int, boxes: Mapping[str, Array], width: int) -> Image:
    image = sequence.read(index)
    factor = width / image.shape[1]
    size = (width, round(image.shape[0] * factor))
    canvas = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    if sequence.valid[index]:
        _rectangle(canvas, sequence.boxes[index] * factor, TRUTH, 1)
    for order, rows in enumerate(boxes.values()):
        _rectangle(canvas, rows[index] * factor, _color(order), 2)
    label = f"{sequence.name} #{sequence.first + index}"
    cv2.rectangle(canvas, (0, 0), (cv2.getTextSize(label, FONT, 0.5, 1)[0][0] + 12, 24), (0, 0, 0), cv2.FILLED)
    cv2.putText(canvas, label, (6, 18), FONT, 0.5, (0, 255, 255), 1, cv2.LINE_AA)
    return canvas


def _rectangle(canvas: Image, box: Array, color: tuple[int, int, int], thickness: int) -> None:
    if np.isfinite(box).all():
        x, y, w, h = box
        corner, opposite = (round(x), round(y)), (round(x + w), round(y + h))
        cv2.rectangle(canvas, corner, opposite, color, thickness, cv2.LINE_AA)


def _legend(names: list[str], width: int) -> list[Image]:
    """Return as many lines of the legend as the names need."""
    lines = [np.zeros((LEGEND_HEIGHT, width, 3), np.uint8)]
    x = 8
    colors = [TRUTH, *(_color(order) for order in range(len(names)))]
    for name, color in zip(["truth", *names], colors, strict=True):
        text_width = cv2.getTextSize(name, FONT, 0.45, 1)[0][0]
        if x + text_width + 34 > width and x > 8:
            lines.append(np.zeros_like(lines[0]))
            x = 8
        cv2.line(lines[-1], (x, 13), (x + 18, 13), color, 3)
        cv2.putText(lines[-1], name, (x + 24, 17), FONT, 0.45, color, 1, cv2.LINE_AA)
        x += text_width + 44
    return lines


def _color(order: int) -> tuple[int, int, int]:
    """Return the plots' color of this order as BGR."""
    code = PALETTE[order % len(PALETTE)]
    return int(code[5:7], 16), int(code[3:5], 16), int(code[1:3], 16)
