"""``mfcmt track --keyframes``: fill in the boxes between frames in which they are known."""

from __future__ import annotations

from collections import Counter, defaultdict
from itertools import chain

from ..errors import MFCMTError
from ..exports import Row, Target
from ..interpolate import Filled, Filler
from ..result import Box
from ..video import Frame
from .follow import Outputs, Step, Task, open_task
from .media import Source
from .signals import Ending


def follow_keyframes(task: Task, ending: Ending, step: Step, source: Source, first: Frame) -> Counter[str]:
    """Fill in what is between the keyframes, and write it at the end; return the number of results by status.

    What is known until an error or a signal is kept. With a video, the source is read a second time to draw in it.

    Raises
    ------
    BadBox
        If a box is not usable in its frame.
    MFCMTError
        If frames or keyframes are missing, or if a result cannot be written.
    Ended
        If a signal ended it.
    """
    fillers = {target: Filler(boxes, task.config) for target, boxes in _by_target(task).items()}
    times: dict[int, float | None] = {}
    rows: dict[int, list[Row]] = defaultdict(list)
    counts: Counter[str] = Counter()

    def keep(target: Target, found: list[Filled]) -> None:
        for one in found:
            rows[one.frame].append(Row(one.frame, times[one.frame], target, one.result, one.keyframe))
            counts[one.result.status] += 1

    size = first.image.shape
    try:
        for frame in chain([first], source.frames):
            if frame.image.shape != size:
                raise MFCMTError(f"frame {frame.index} has another size than the first one: keyframes need one size")
            with ending.held():
                times[frame.index] = frame.time_s
                for target, filler in fillers.items():
                    keep(target, filler.push(frame.index, frame.image))
                step(frame.index + 1, source.length, "")
    finally:
        with ending.held():
            for target, filler in fillers.items():
                keep(target, filler.finish())
            _write(task, source, first, rows, max(times, default=-1) + 1)
    missing = [f"{target.name}, frame {n}" for target, filler in fillers.items() for n in filler.missing]
    if missing:
        raise MFCMTError(f"{task.source} has no such frame for these keyframes: {'; '.join(missing)}")
    return counts


def _by_target(task: Task) -> dict[Target, dict[int, Box]]:
    boxes: dict[Target, dict[int, Box]] = defaultdict(dict)
    for start in task.starts:
        boxes[start.target][start.frame] = start.box
    return boxes


def _write(task: Task, source: Source, first: Frame, rows: dict[int, list[Row]], length: int) -> None:
    """Write all rows, and draw them if a video is wanted. Raises MFCMTError."""
    if not rows:
        return
    outputs = Outputs(task, source, first)
    try:
        if task.video is None:
            for number in sorted(rows):
                outputs.rows(rows[number])
            return
        again, begin = open_task(task)
        for frame in chain([begin], again.frames):
            outputs.write(frame, rows.get(frame.index, []))
    finally:
        outputs.close(length)
