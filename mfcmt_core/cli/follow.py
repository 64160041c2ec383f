"""Follow the targets of one source to its end, and write the results while it goes on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from ..config import MFCMTConfig
from ..errors import MFCMTError
from ..exports import Clip, Options, Row, open_writer
from ..video import Frame
from ..video.sound import Sound
from ..video.write import VideoWriter
from .media import MediaError, Source, open_source
from .overlay import Overlay
from .signals import Ended, Ending
from .targets import Follower, Start

Step = Callable[[int, int | None, str], None]
"""Is told the frames done, all frames if known, and the status of the first target."""


@dataclass(frozen=True)
class Task:
    """What to track in one source, and where the results go. ``starts`` may be filled in when the source is open."""

    source: str
    starts: tuple[Start, ...]
    config: MFCMTConfig
    options: Options
    video: Path | None = None
    audio: bool = False
    rescale: bool = False
    fps: float | None = None
    for_s: float | None = None
    retry_s: float = 60.0


def follow(task: Task, ending: Ending, step: Step, source: Source, first: Frame) -> Counter[str]:
    """Track from the first frame to the end of the source and return the number of results by status.

    What was tracked until an error or a signal is kept, in a file that is whole.

    Raises
    ------
    BadBox
        If a target of the first frame cannot be started; nothing is written then.
    MFCMTError
        If frames are missing or cannot be read, or if a result cannot be written.
    Ended
        If a signal ended it; not Ctrl-C at a camera, which ends only like this.
    """
    follower = Follower(task.starts, task.config, rescale=task.rescale)
    rows = follower.update(first)
    counts: Counter[str] = Counter()
    length = 0
    outputs = Outputs(task, source, first)
    try:
        for frame in chain([first], source.frames):
            with ending.held():
                rows = rows if frame is first else follower.update(frame)
                outputs.write(frame, rows)
                length = frame.index + 1
                counts.update(row.result.status for row in rows)
                step(length, source.length, rows[0].result.status if rows else "waiting")
    except KeyboardInterrupt as ended:
        if not source.live or (isinstance(ended, Ended) and ended.code != 130):
            raise
    finally:
        with ending.held():
            outputs.close(max(length, source.length or 0))
    refused = follower.refused + [
        f"{start.target.name} begins at frame {start.frame}, after the last" for start in follower.waiting
    ]
    if refused:
        raise MFCMTError(f"{task.source}: {'; '.join(refused)}")
    return counts


def open_task(task: Task) -> tuple[Source, Frame]:
    """Return the source and its first frame. Raises UsageError and MFCMTError."""
    source = open_source(task.source, task.fps, task.for_s, task.retry_s)
    first = next(source.frames, None)
    if first is None:
        raise MFCMTError(f"no frames in {task.source}")
    return source, first


class Outputs:
    """The boxes and the video of a task."""

    def __init__(self, task: Task, source: Source, first: Frame) -> None:
        self._task, self._fps = task, source.fps
        height, width = first.image.shape[:2]
        clip = Clip(source.path.name if source.path else "camera", width, height, source.fps, source.images)
        try:
            self._rows = open_writer(task.options, clip)
        except OSError as failed:
            raise self._unwritten(failed) from failed
        self._video: VideoWriter | None = None
        if task.video is not None:
            sound = Sound(source.path, source.origin_s) if task.audio and source.path is not None else None
            self._video = VideoWriter(task.video, source.fps, sound)
        self._overlay = Overlay(list(dict.fromkeys(start.target for start in task.starts)))

    def write(self, frame: Frame, rows: Sequence[Row]) -> None:
        """Write a frame's results, and draw them. Raises MFCMTError."""
        self.rows(rows)
        if self._video:
            time_s = frame.index / self._fps if frame.time_s is None else frame.time_s
            self._video.write(self._overlay.draw(frame.image, rows), time_s)

    def rows(self, rows: Sequence[Row]) -> None:
        """Write a frame's results. Raises MFCMTError."""
        try:
            self._rows.write(rows)
        except BrokenPipeError:
            raise
        except OSError as failed:
            raise self._unwritten(failed) from failed

    def close(self, length: int) -> None:
        """Complete the files, the one even if the other cannot be. Raises MFCMTError."""
        try:
            self._rows.close(length)
        except BrokenPipeError:
            raise
        except OSError as failed:
            raise self._unwritten(failed) from failed
        finally:
            if self._video:
                self._video.close()

    def _unwritten(self, failed: OSError) -> MediaError:
        name = self._task.options.output or "the standard output"
        return MediaError(f"cannot write {name}: {failed.strerror or failed}")
