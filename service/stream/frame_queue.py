"""What waits for the lane: one frame at most in ``latest``, as many as the credit in ``lossless``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from ..inbox import Inbox
from ..protocol.enums import Mode, ProblemCode
from ..protocol.problems import ProblemError
from ..protocol.requests import Control
from ..sessions.byte_budget import Reservation
from ..sessions.interface import QueuedFrame

MAX_WAITING_CONTROLS = 64


@dataclass(slots=True)
class Job:
    """A frame and the controls that act on it, or a control alone."""

    frame: QueuedFrame | None
    controls: list[Control] = field(default_factory=list)


class FrameQueue:
    """The queue between the reader of a socket and the session, in the order of the messages.

    Parameters
    ----------
    mode, credit
        In ``lossless`` at most ``credit`` frames are unanswered; in ``latest`` a newer frame supersedes a waiting one.
    on_superseded
        Called for each frame that is superseded.
    share
        Holds the bytes of frames from here until they are answered.
    """

    def __init__(self, mode: Mode, credit: int, on_superseded: Callable[[], None], share: Reservation) -> None:
        self.mode = mode
        self.dropped = 0
        self._on_superseded = on_superseded
        self._credit = credit
        self._share = share
        self._unanswered = 0
        self._inbox: Inbox[Job] = Inbox()
        self._jobs = self._inbox.messages
        self._controls = 0
        self._for_next: list[Control] = []

    @property
    def empty(self) -> bool:
        """Whether nothing waits for the lane."""
        return not self._jobs

    def take_for_next(self) -> list[Control]:
        """Return the controls that waited for the frame message that has just come."""
        controls, self._for_next = self._for_next, []
        return controls

    def put_frame(self, frame: QueuedFrame, controls: list[Control]) -> None:
        """Queue a frame; in ``latest`` it supersedes the one that waits. Raises over-credit, at-capacity.

        A frame with controls of its own is not superseded: they would act on a frame they were not made for.
        """
        if self.mode == Mode.LOSSLESS:
            if self._unanswered >= self._credit:
                detail = f"at most {self._credit} unanswered frames"
                raise ProblemError(ProblemCode.OVER_CREDIT, detail, retry_after_s=0.1)
            self._share.grow(len(frame.data))
            self._unanswered += 1
        else:
            stale = next((job for job in self._jobs if job.frame is not None and not job.controls), None)
            if stale is not None and stale.frame is not None:
                self._share.grow(len(frame.data) - len(stale.frame.data))
                self._jobs.remove(stale)
                self.dropped += 1
                self._on_superseded()
            else:
                self._share.grow(len(frame.data))
        self._inbox.put_nowait(Job(frame, controls))

    def put_control(self, control: Control) -> None:
        """Queue a control. Raises rate-limited when too many wait."""
        if self._controls >= MAX_WAITING_CONTROLS:
            raise ProblemError(ProblemCode.RATE_LIMITED, "too many controls wait", retry_after_s=0.1)
        self._controls += 1
        if control.on == "next":
            self._for_next.append(control)
        else:
            self._inbox.put_nowait(Job(None, [control]))

    async def next(self) -> Job:
        """Wait for the next job and return it."""
        await self._inbox.wait()
        return self._jobs.popleft()

    def answered(self, job: Job) -> None:
        """Release what ``job`` held, as the client is about to have its answer."""
        self._controls -= len(job.controls)
        if job.frame is not None:
            self._share.shrink(len(job.frame.data))
            if self.mode == Mode.LOSSLESS:
                self._unanswered -= 1

    def refused(self, controls: list[Control]) -> None:
        """Release controls that were refused with their frame."""
        self._controls -= len(controls)

    def take_dropped(self) -> int:
        """Return the number of frames superseded since the last call."""
        dropped, self.dropped = self.dropped, 0
        return dropped

    def discard(self) -> None:
        """Forget all that waits."""
        self._share.shrink(sum(len(job.frame.data) for job in self._jobs if job.frame is not None))
        self._jobs.clear()
        self._for_next.clear()

    def close(self) -> None:
        """Forget all that waits, and release what is still held: nothing comes or is answered any more."""
        self.discard()
        self._share.resize(0)
