"""Label Studio: a task with a prediction, a video rectangle a target with a keyframe where its path bends."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from .paths import points
from .rows import Clip, Row, by_target

CONFIG = """<View>
  <Video name="video" value="$video" framerate="{fps:g}"/>
  <VideoRectangle name="box" toName="video"/>
  <Labels name="label" toName="video">{labels}</Labels>
</View>"""
"""The labelling interface that a project needs for these tasks."""


def labelstudio(clip: Clip, rows: Iterable[Row], tolerance: float, length: int) -> list[dict[str, Any]]:
    """Return the tasks of an import: one. Frames count from 1, boxes are in percent of the frame.

    ``length`` is the number of frames. A person sets ``data.video`` to where the project has the video.
    """
    duration = round(length / clip.fps, 6)
    result = []
    for target, path in by_target(rows).items():
        keyframes = sequence(clip, path, tolerance, ends=path[-1].frame < length - 1)
        confidences = [row.result.confidence for row in path]
        result.append(
            {
                "id": f"target-{target.id}",
                "type": "videorectangle",
                "from_name": "box",
                "to_name": "video",
                "score": round(sum(confidences) / len(confidences), 4),
                "meta": {"text": [target.name]},
                "value": {
                    "framesCount": length,
                    "duration": duration,
                    "sequence": keyframes,
                    "labels": [target.kind],
                },
            }
        )
    return [{"data": {"video": clip.name}, "predictions": [{"model_version": "mfcmt", "result": result}]}]


def sequence(clip: Clip, rows: list[Row], tolerance: float, *, ends: bool) -> list[dict[str, Any]]:
    """Return the keyframes of one target's rows. After one that is not enabled, the box is away until the next.

    ``ends`` says that the box is away after the last of them; ``tolerance`` is in pixels.
    """
    path = list(points(clip, rows, tolerance))
    shown = [*(point.present for point in path[1:]), not ends]
    return [
        {
            "frame": point.frame + 1,
            "time": round(point.time_s if point.time_s is not None else point.frame / clip.fps, 6),
            "enabled": goes_on,
            "rotation": 0,
            "x": round(100 * point.box[0] / clip.width, 4),
            "y": round(100 * point.box[1] / clip.height, 4),
            "width": round(100 * point.box[2] / clip.width, 4),
            "height": round(100 * point.box[3] / clip.height, 4),
        }
        for point, goes_on in zip(path, shown, strict=True)
        if point.present
    ]
