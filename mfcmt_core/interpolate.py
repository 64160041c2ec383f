"""Fill in a target's boxes between frames in which they are known: tracked from both ends, and joined."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import IO

import numpy as np
import numpy.typing as npt

from .config import MFCMTConfig
from .errors import BadBox
from .result import TrackResult
from .tracker import MFCMT

Image = npt.NDArray[np.uint8]
Array = npt.NDArray[np.float64]

KEPT_BYTES = 512 * 2**20
"""Bytes of frames between two keyframes that are kept in memory; more go to a temporary file."""

AGREE = 0.3
"""Overlap from which the boxes of both directions are one place, and their weighted mean is taken."""
_DISTANCE, _CONFIDENCE, _CHANGE = 0.5, 2.0, 5.0
_LEAST = 1e-3


@dataclass(frozen=True, slots=True)
class Filled:
    """A box that was filled in: its frame, the result, and the frame of the keyframe that it was tracked from."""

    frame: int
    result: TrackResult
    keyframe: int


def interpolate(
    frames: Iterable[Image], keyframes: Mapping[int, Iterable[float]], config: MFCMTConfig | None = None
) -> Iterator[Filled]:
    """Yield a result for every frame, from boxes that are known in some of them.

    Between two keyframes the target is tracked forward from the one and backward from the other. Where both agree,
    the box is their mean, weighted by confidence and nearness; where they do not, the more credible way is taken, and
    left where the two come closest. Before the first keyframe it is tracked backward, after the last one forward.

    Parameters
    ----------
    frames : iterable of ndarray, shape (H, W) or (H, W, 3), uint8
        The frames in order, all of one size; BGR.
    keyframes : mapping of int to box
        ``(x, y, w, h)`` in pixels by frame number, from 0.
    config : MFCMTConfig, optional
        Of the tracker; the default preset without.

    Yields
    ------
    Filled
        In the order of the frames. The box of a keyframe is the given one, with confidence 1.

    Raises
    ------
    BadBox
        If a box is not usable in its frame.
    ValueError
        If there is no keyframe, or one has no frame.
    """
    filler = Filler(keyframes, config)
    for index, image in enumerate(frames):
        yield from filler.push(index, image)
    yield from filler.finish()
    if filler.missing:
        raise ValueError(f"the keyframe {filler.missing[0]} has no frame")


class Filler:
    """Does the work of :func:`interpolate` frame by frame: results come when the next keyframe has come."""

    def __init__(self, keyframes: Mapping[int, Iterable[float]], config: MFCMTConfig | None = None) -> None:
        if not keyframes:
            raise ValueError("there is no keyframe")
        self._boxes = {frame: tuple(map(float, keyframes[frame])) for frame in sorted(keyframes)}
        self._config = config or MFCMTConfig.default()
        self._last = max(self._boxes)
        self._came: set[int] = set()
        self._start: int | None = None  # the keyframe at which the stretch in hand begins
        self._forward: MFCMT | None = None
        self._ahead: list[TrackResult] = []
        self._frames: list[int] = []
        self._reel = _Reel()

    @property
    def missing(self) -> list[int]:
        """The keyframes that have not come."""
        return sorted(set(self._boxes) - self._came)

    def push(self, frame: int, image: Image) -> list[Filled]:
        """Take the next frame and return the results that are known by it. Raises BadBox."""
        box = self._boxes.get(frame)
        if box is not None:
            return self._keyframe(frame, image, box)
        self._frames.append(frame)
        if self._forward is not None:
            self._ahead.append(self._forward.update(image))
        if frame > self._last:  # no keyframe comes that it could be tracked back from
            return self.finish()
        self._reel.append(image)
        return []

    def finish(self) -> list[Filled]:
        """Return what is left: tracked forward from the keyframe before."""
        rest = []
        if self._start is not None:
            pairs = zip(self._frames, self._ahead, strict=True)
            rest = [Filled(frame, result, self._start) for frame, result in pairs]
        self._begin(self._start)
        return rest

    def _keyframe(self, frame: int, image: Image, box: tuple[float, ...]) -> list[Filled]:
        found = self._stretch(frame, image, box)
        self._forward = MFCMT(self._config)
        found.append(Filled(frame, _started(self._forward, image, box, frame), frame))
        self._came.add(frame)
        self._begin(frame)
        return found

    def _begin(self, start: int | None) -> None:
        self._start, self._frames, self._ahead = start, [], []
        self._reel.close()
        self._reel = _Reel()

    def _stretch(self, frame: int, image: Image, box: tuple[float, ...]) -> list[Filled]:
        """Return the results between the keyframe before and this one."""
        backward = MFCMT(self._config)
        _started(backward, image, box, frame)
        back = [backward.update(self._reel[at]) for at in reversed(range(len(self._frames)))][::-1]
        if self._start is None or not back:
            return [Filled(n, result, frame) for n, result in zip(self._frames, back, strict=True)]
        shares = (np.array(self._frames, float) - self._start) / (frame - self._start)
        keys = (self._start, frame)
        joined = join(self._ahead, back, shares)
        return [Filled(n, result, keys[side]) for n, (result, side) in zip(self._frames, joined, strict=True)]


def _started(tracker: MFCMT, image: Image, box: tuple[float, ...], frame: int) -> TrackResult:
    try:
        return tracker.init(image, box)
    except BadBox as bad:
        raise BadBox(f"keyframe {frame}: {bad.reason}", box) from bad


def join(ahead: list[TrackResult], back: list[TrackResult], shares: Array) -> list[tuple[TrackResult, int]]:
    """Join what was tracked from both ends.

    Parameters
    ----------
    ahead, back : list of TrackResult, length N
        Results of the frames between two keyframes, tracked forward and backward.
    shares : ndarray of float64, shape (N,)
        Where each frame lies between the keyframes, 0 to 1.

    Returns
    -------
    list of (TrackResult, int)
        The result of each frame, and 0 if it is mainly the forward one, 1 for the backward one.
    """
    boxes = np.array([[r.box for r in results] for results in (ahead, back)])  # (2, N, 4)
    confidence = np.clip([[r.confidence for r in results] for results in (ahead, back)], _LEAST, 1)
    nearness = np.clip([1 - shares, shares], _LEAST, 1)
    overlaps = _overlap(boxes[0], boxes[1])
    chosen = _path(-np.log(confidence**_CONFIDENCE * nearness**_DISTANCE).T, -_CHANGE * np.log(overlaps))
    weights = confidence * nearness
    weights /= weights.sum(axis=0)
    found = []
    for at, (one, other) in enumerate(zip(ahead, back, strict=True)):
        side = int(weights[1, at] > 0.5) if overlaps[at] > AGREE else int(chosen[at])
        result = (one, other)[side]
        if overlaps[at] > AGREE:
            x, y, w, h = map(float, weights[:, at] @ boxes[:, at])
            sure = float(weights[:, at] @ confidence[:, at])
            result = replace(result, box=(x, y, w, h), confidence=sure)
        found.append((result, side))
    return found


def _path(costs: Array, changes: Array) -> npt.NDArray[np.int_]:
    """Return the cheapest way, 0 or 1 for each frame, that begins at 0 and ends at 1.

    ``costs`` is (N, 2); ``changes``, (N,), is what it costs to go over to the other in a frame.
    """
    count = len(costs)
    came = np.zeros((count, 2), int)
    best = costs[0] + [0.0, changes[0]]
    sides = np.arange(2)
    for at in range(1, count):
        over = best[::-1] + changes[at]
        came[at] = np.where(over < best, sides[::-1], sides)
        best = np.minimum(best, over) + costs[at]
    way = np.zeros(count, int)
    side = int(best[1] <= best[0])
    for at in reversed(range(count)):
        way[at] = side
        side = int(came[at, side])
    return way


def _overlap(one: Array, other: Array) -> Array:
    """Return intersection over union of boxes (N, 4), at least 0.001."""
    low = np.maximum(one[:, :2], other[:, :2])
    high = np.minimum(one[:, :2] + one[:, 2:], other[:, :2] + other[:, 2:])
    inner = np.prod(np.clip(high - low, 0, None), axis=1)
    union = np.prod(one[:, 2:], axis=1) + np.prod(other[:, 2:], axis=1) - inner
    return np.asarray(np.clip(inner / union, _LEAST, 1), float)


class _Reel:
    """Frames to be read again, in memory while they are few, then in a temporary file."""

    def __init__(self) -> None:
        self._kept: list[Image] = []
        self._bytes = 0
        self._file: IO[bytes] | None = None

    def append(self, image: Image) -> None:
        self._bytes += image.nbytes
        if self._bytes <= KEPT_BYTES:
            self._kept.append(image)
            return
        if self._file is None:
            self._file = tempfile.TemporaryFile(prefix="mfcmt-frames-")  # noqa: SIM115
        self._file.write(np.ascontiguousarray(image).data)

    def __getitem__(self, index: int) -> Image:
        if index < len(self._kept):
            return self._kept[index]
        assert self._file is not None
        like = self._kept[0]
        self._file.seek((index - len(self._kept)) * like.nbytes)
        return np.frombuffer(self._file.read(like.nbytes), np.uint8).reshape(like.shape)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
