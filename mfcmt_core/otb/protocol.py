"""Where runs start: one-pass (OPE), temporal (TRE) and spatial robustness evaluation (SRE).

The rules are those of the MATLAB toolkit ``tracker_benchmark_v1.0`` (Wu et al., 2013,
https://doi.org/10.1109/CVPR.2013.312), which computes with 1-based pixels; boxes here are 0-based like everywhere
else in this package.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..result import Box
from .dataset import ONE_BASED, Sequence
from .metrics import Array

SEGMENTS = 20
MIN_SEGMENT_FRAMES = 20
SHIFTS = ("left", "right", "up", "down", "topLeft", "topRight", "bottomLeft", "bottomRight")
SCALES = {"scale_8": 0.8, "scale_9": 0.9, "scale_11": 1.1, "scale_12": 1.2}


@dataclass(frozen=True)
class Run:
    """One run of a tracker: from frame ``start`` (index into the sequence) to the end, begun on ``box``.

    ``ratio`` is the size of ``box`` relative to the truth where the protocol scores at the original size.
    """

    key: str
    start: int
    box: Box
    ratio: float = 1.0


def ope(sequence: Sequence) -> list[Run]:
    """Return the run of OPE: one pass from the first frame with a valid box, begun on this box."""
    start = int(np.flatnonzero(sequence.valid)[0])
    return [Run("", start, _box(sequence.boxes[start]))]


def tre(sequence: Sequence) -> list[Run]:
    """Return the runs of TRE: 20 starts evenly spread over the frames with a visible target, each to the end.

    A short sequence has fewer, as in the toolkit.
    """
    candidates = np.flatnonzero(sequence.startable)
    late_enough = np.flatnonzero(len(sequence) - candidates >= MIN_SEGMENT_FRAMES)
    if not late_enough.size:
        return ope(sequence)
    last = int(late_enough[-1]) + 1
    # MATLAB: [floor(1 : last/19 : last), last]
    steps = [1 + k * last // (SEGMENTS - 1) for k in range((last - 1) * (SEGMENTS - 1) // last + 1)]
    starts = [int(candidates[step - 1]) for step in [*steps, last]]
    return [Run(f"{k:02d}", start, _box(sequence.boxes[start])) for k, start in enumerate(starts, 1)]


def sre(sequence: Sequence) -> list[Run]:
    """Return the 12 runs of SRE: the first box moved in 4 directions, grown at 4 corners, scaled by 4 factors.

    Shifts are a tenth of the box's sides, factors are 0.8 to 1.2; all runs go from the first valid frame to the end.
    """
    start = ope(sequence)[0].start
    one_based = sequence.boxes[start] + ONE_BASED
    return [
        Run(
            key,
            start,
            _box(shifted(one_based, key, sequence.image_size) - ONE_BASED),
            SCALES.get(key, 1.0),
        )
        for key in (*SHIFTS, *SCALES)
    ]


def shifted_starts(sequence: Sequence) -> list[Run]:
    """Return three runs, from the first annotated frame and from 10 and 20 frames later: no toolkit's protocol.

    The score of a single pass depends on a few coincidences, such as a loss at an occlusion, which another start
    changes. So a choice between trackers is made on several passes.
    """
    first = ope(sequence)[0].start
    starts = [s for s in (first, first + 10, first + 20) if s < len(sequence) and sequence.valid[s]]
    return [Run(f"{s - first + 1:02d}", s, _box(sequence.boxes[s])) for s in starts]


PROTOCOLS: dict[str, Callable[[Sequence], list[Run]]] = {
    "OPE": ope,
    "TRE": tre,
    "SRE": sre,
    "STARTS": shifted_starts,
}


def shifted(box: Array, key: str, image_size: tuple[int, int] | None) -> Array:
    """Return a start box of SRE (1-based in and out), clipped to the image as the toolkit does.

    ``left`` to ``down`` move the box; ``topLeft`` to ``bottomRight`` move that corner outwards, so that the
    box grows; ``scale_*`` keep the center.
    """
    x, y, w, h = (float(v) for v in box)
    if key in SCALES:
        ratio = SCALES[key]
        cx, cy, w, h = x + w / 2, y + h / 2, w * ratio, h * ratio
        x, y, w, h = (_round(v) for v in (cx - w / 2, cy - h / 2, w, h))
    elif key in ("left", "right"):
        x += math.ceil(0.1 * w) * (1 if key == "right" else -1)
    elif key in ("up", "down"):
        y += math.ceil(0.1 * h) * (1 if key == "down" else -1)
    else:
        right, bottom = x + w - 1, y + h - 1
        if key.endswith("Left"):
            x = _round(x - 0.1 * w)
        else:
            right = _round(right + 0.1 * w)
        if key.startswith("top"):
            y = _round(y - 0.1 * h)
        else:
            bottom = _round(bottom + 0.1 * h)
        w, h = right - x + 1, bottom - y + 1
    x, y = max(x, 1.0), max(y, 1.0)
    if image_size is not None:
        w, h = min(w, image_size[0] - x + 1), min(h, image_size[1] - y + 1)
    return np.array([x, y, w, h])


def to_original_size(boxes: Array, ratio: float) -> Array:
    """Return the boxes (1-based) of a run begun on a scaled box, divided by ``ratio`` about the center, rounded."""
    if ratio == 1.0:
        return boxes
    center = boxes[:, :2] + (boxes[:, 2:] - 1) / 2
    size = boxes[:, 2:] / ratio
    moved = np.hstack([center - size / 2, size])
    return np.asarray(np.sign(moved) * np.floor(np.abs(moved) + 0.5))


def _round(value: float) -> float:
    """Round as MATLAB does: halves away from zero."""
    return math.copysign(math.floor(abs(value) + 0.5), value)


def _box(row: Array) -> Box:
    x, y, w, h = (float(v) for v in row)
    return x, y, w, h
