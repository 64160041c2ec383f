"""Label Studio's tasks: the boxes from which tracks go on, and the predictions that are made of them.

Label Studio counts frames from 1 and has boxes in percent of the frame. A frame's time is its number over the frames a
second of the labelling interface, which may differ from the video's own.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

from mfcmt_core.exports.labelstudio import sequence
from mfcmt_core.exports.rows import Clip, Row
from mfcmt_core.exports.rows import Target as Exported
from mfcmt_core.result import TrackResult

from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError

KIND = "videorectangle"
MODEL_VERSION = "mfcmt"
# Edges between two keyframes may be off by as much.
TOLERANCE_PX = 1.0
MAX_KEYFRAMES = 10_000
VIDEO_TAG = re.compile(r"<Video\b[^>]*>")
ATTRIBUTE = re.compile(r'\b(\w+)="([^"]*)"')
MAX_FPS = 1000.0
PERCENT = ("x", "y", "width", "height")


@dataclass(slots=True)
class Track:
    """A video rectangle of a task: its keyframes so far, the last of which is where the track goes on.

    ``rows`` are what was tracked from there, in the frames of Label Studio from 0.
    """

    id: str
    from_name: str
    to_name: str
    value: Mapping[str, Any]
    known: list[dict[str, Any]]
    frames: int
    duration_s: float
    rows: list[Row] = field(default_factory=list)

    @property
    def start(self) -> int:
        """The frame of the last keyframe, from 1."""
        return int(self.known[-1]["frame"])

    @property
    def fps(self) -> float:
        """Frames a second, as Label Studio counts them."""
        return self.frames / self.duration_s

    def box(self, size: tuple[int, int]) -> list[float]:
        """Return the box of the last keyframe, x, y, w, h in pixels of frames of ``size``."""
        return [self.known[-1][name] / 100 * size[place % 2] for place, name in enumerate(PERCENT)]

    def add(self, frame: int, target: Mapping[str, Any]) -> None:
        """Add what was found in a frame, from 1; of several pictures of one frame the last counts."""
        if self.rows and self.rows[-1].frame == frame - 1:
            self.rows.pop()
        confidence = 1.0 if target["confidence"] is None else target["confidence"]
        x, y, w, h = target["box"]
        found = TrackResult((x, y, w, h), target["status"], None, None, None, None, False, 1.0, confidence)
        self.rows.append(Row(frame - 1, frame / self.fps, Exported(), found))


def tracks_of(task: Mapping[str, Any], context: Mapping[str, Any] | None) -> list[Track]:
    """Return the tracks that go on in a task: those of ``context``, which a person draws, or else those that it has.

    A rectangle goes on from its last keyframe that is shown, unless it has ended before the video does. Raises
    bad-request.
    """
    if context is not None:
        return _tracks(context.get("result"))
    for source in ("annotations", "drafts", "predictions"):
        for one in reversed(_list(task.get(source) or [])):
            if found := _tracks(one.get("result") if isinstance(one, dict) else None):
                return found
    return []


def video_of(task: Mapping[str, Any], label_config: str, to_name: str) -> str:
    """Return the URL of the task's video, that of the tag ``to_name``. Raises bad-request."""
    tags = [dict(ATTRIBUTE.findall(tag)) for tag in VIDEO_TAG.findall(label_config)]
    tag = next((tag for tag in tags if tag.get("name") == to_name), {})
    data = task.get("data")
    url = data.get(tag.get("value", "").removeprefix("$")) if isinstance(data, dict) else None
    if type(url) is not str or not url:
        raise _bad("the task has no video: a Video tag of the labelling interface names the field with its URL")
    return url


def prediction(tracks: Iterable[Track], size: tuple[int, int]) -> dict[str, Any]:
    """Return the prediction of a task with frames of ``size``: the keyframes before and after each start."""
    result, scores = [], []
    for track in tracks:
        clip = Clip("video", *size, track.fps)
        confidences = [row.result.confidence for row in track.rows]
        ends = track.rows[-1].frame < track.frames - 1 and track.rows[-1].result.status == "lost"
        after = sequence(clip, track.rows, TOLERANCE_PX, ends=ends)
        by_frame = {row.frame + 1: row.result.confidence for row in track.rows}
        scores.append(sum(confidences) / len(confidences))
        lowest = min(confidences)
        text = (
            f"confidence {scores[-1]:.2f}, lowest {lowest:.2f}, of frames {track.start} to {track.rows[-1].frame + 1}"
        )
        result.append(
            {
                "id": track.id,
                "from_name": track.from_name,
                "to_name": track.to_name,
                "type": KIND,
                "origin": "manual",
                "score": round(scores[-1], 4),
                "meta": {"text": [text], "confidence": round(scores[-1], 4), "lowest": round(lowest, 4)},
                "value": {
                    **track.value,
                    "framesCount": track.frames,
                    "duration": track.duration_s,
                    "sequence": track.known[:-1]
                    + [one | {"score": round(by_frame.get(one["frame"], scores[-1]), 4)} for one in after],
                },
            }
        )
    score = round(sum(scores) / len(scores), 4) if scores else 0.0
    return {"model_version": MODEL_VERSION, "score": score, "result": result}


def _tracks(result: Any) -> list[Track]:
    regions = [one for one in _list(result or []) if isinstance(one, dict) and one.get("type") == KIND]
    return [track for track in map(_track, regions) if track is not None]


def _track(region: Mapping[str, Any]) -> Track | None:
    """Return the track of a region, None if it has no keyframe to go on from. Raises bad-request."""
    value = region.get("value")
    if not isinstance(value, dict):
        raise _bad("a video rectangle has a value")
    names = [region.get(name) for name in ("id", "from_name", "to_name")]
    if not all(type(name) is str and 0 < len(name) <= 200 for name in names):
        raise _bad("a video rectangle has an id, from_name and to_name")
    keyframes = sorted(map(_keyframe, _list(value.get("sequence"))), key=lambda one: one["frame"])
    frames, duration = value.get("framesCount"), value.get("duration")
    if type(frames) is not int or not _is_number(duration) or not 0 < frames <= MAX_FPS * float(duration or 0):
        raise _bad("a video rectangle has framesCount and duration")
    while keyframes and not keyframes[-1]["enabled"] and keyframes[-1]["frame"] >= frames:
        keyframes.pop()
    if not keyframes or not keyframes[-1]["enabled"]:
        return None
    rest = {name: value[name] for name in ("labels",) if name in value}
    return Track(str(names[0]), str(names[1]), str(names[2]), rest, keyframes, frames, float(duration or 0))


def _keyframe(sent: Any) -> dict[str, Any]:
    """Return a keyframe of a sequence as it was sent, with ``enabled``. Raises bad-request."""
    if not isinstance(sent, dict) or type(sent.get("frame")) is not int or sent["frame"] < 1:
        raise _bad("a keyframe has a frame, from 1")
    if not all(_is_number(sent.get(name)) for name in PERCENT):
        raise _bad("a keyframe has x, y, width and height in percent")
    return {"enabled": True, **sent}


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and isfinite(value) and abs(value) < 1e9


def _list(value: Any) -> list[Any]:
    if type(value) is not list or len(value) > MAX_KEYFRAMES:
        raise _bad("annotations, drafts, predictions, result and sequence are lists")
    return value


def _bad(detail: str) -> ProblemError:
    return ProblemError(ProblemCode.BAD_REQUEST, detail)
