"""Follow the targets of one source to its end, and write the results while it goes on."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from ..config import MFCMTConfig
from ..errors import MFCMTError
from ..exports import Clip, Options, Row, open_writer
from ..video import Frame
from ..video.sound import Sound
from ..video.write import VideoWriter
from .media import MediaError, Source
from .overlay import Overlay
from .progress import Progress
from .signals import Ended, Ending
from .targets import Follower, Start


@dataclass(frozen=True)
class Job:
    """A source whose first frame was read, the targets in it, and where the results go."""

    source: Source
    first: Frame
    starts: Sequence[Start]
    config: MFCMTConfig
    options: Options
    video: Path | None = None
    audio: bool = False
    rescale: bool = False

    @property
    def clip(self) -> Clip:
        """What exports need to know of the source."""
        height, width = self.first.image.shape[:2]
        name = self.source.path.name if self.source.path else "camera"
        return Clip(name, width, height, self.source.fps, self.source.images)


def follow(job: Job, ending: Ending) -> Counter[str]:
    """Track to the end of the source and return the number of results by status.

    What was tracked until an error or a signal is kept, in a file that is whole.

    Raises
    ------
    BadBox
        If a target of the first frame cannot be started; nothing is written then.
    MFCMTError
        If frames are missing or cannot be read, or if a result cannot be written.
    Ended
        If a signal ended it; not for a camera, which ends only like this.
    """
    follower = Follower(job.starts, job.config, rescale=job.rescale)
    rows = follower.update(job.first)
    counts: Counter[str] = Counter()
    length = 0
    with ExitStack() as stack:
        outputs = _Outputs(job)
        shown = job.options.output is not None or not sys.stdout.isatty()  # boxes on a terminal show the progress
        bar = stack.enter_context(Progress(job.source.length, shown=shown))
        try:
            for frame in chain([job.first], job.source.frames):
                with ending.held():
                    rows = rows if frame is job.first else follower.update(frame)
                    outputs.write(frame, rows)
                    length = frame.index + 1
                    counts.update(row.result.status for row in rows)
                    bar.step(rows[0].result.status if rows else "waiting")
        except KeyboardInterrupt as ended:
            if not job.source.live or (isinstance(ended, Ended) and ended.code != 130):
                raise
        finally:
            with ending.held():
                outputs.close(max(length, job.source.length or 0))
    refused = follower.refused + [
        f"{start.target.name} begins at frame {start.frame}, after the last" for start in follower.waiting
    ]
    if refused:
        raise MFCMTError(f"{job.clip.name}: {'; '.join(refused)}")
    return counts


class _Outputs:
    """The boxes and the video of a job."""

    def __init__(self, job: Job) -> None:
        self._job = job
        options = job.options
        try:
            self._rows = open_writer(options, job.clip)
        except OSError as failed:
            raise self._unwritten(failed) from failed
        self._video = self._writer() if job.video else None
        self._overlay = Overlay([start.target for start in job.starts])

    def _writer(self) -> VideoWriter:
        job, sound = self._job, None
        assert job.video is not None
        if job.audio and job.source.path is not None:
            sound = Sound(job.source.path, job.source.origin_s)
        return VideoWriter(job.video, job.source.fps, sound)

    def write(self, frame: Frame, rows: Sequence[Row]) -> None:
        """Write a frame's results. Raises MFCMTError."""
        try:
            self._rows.write(rows)
        except BrokenPipeError:
            raise
        except OSError as failed:
            raise self._unwritten(failed) from failed
        if self._video:
            time_s = frame.index / self._job.source.fps if frame.time_s is None else frame.time_s
            self._video.write(self._overlay.draw(frame.image, rows), time_s)

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
        name = self._job.options.output or "the standard output"
        return MediaError(f"cannot write {name}: {failed.strerror or failed}")
