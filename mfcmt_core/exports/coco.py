"""COCO for video: images with the number of their video and frame, annotations with the number of their track."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from .lines import time_of
from .rows import Clip, Row, by_target, seen


def coco(clip: Clip, rows: Iterable[Row]) -> dict[str, Any]:
    """Return the document. Numbers count from 1, ``frame_id`` from 0; a lost target has no annotation.

    ``track_id`` (TAO) and ``instance_id`` (CocoVID) are the same number.
    """
    tracks = by_target(rows)
    kinds = {kind: number for number, kind in enumerate(dict.fromkeys(t.kind for t in tracks), 1)}
    images: dict[int, dict[str, Any]] = {}
    annotations: list[dict[str, Any]] = []
    for target, path in tracks.items():
        for row in path:
            images.setdefault(
                row.frame,
                {
                    "id": row.frame + 1,
                    "video_id": 1,
                    "frame_id": row.frame,
                    "file_name": clip.image(row.frame),
                    "width": clip.width,
                    "height": clip.height,
                    "time_s": time_of(row),
                },
            )
            box = seen(clip, row)
            if box is None:
                continue
            x, y, w, h = (round(v, 3) for v in box)
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": row.frame + 1,
                    "video_id": 1,
                    "track_id": target.id,
                    "instance_id": target.id,
                    "category_id": kinds[target.kind],
                    "bbox": [x, y, w, h],
                    "area": round(w * h, 3),
                    "segmentation": [],
                    "iscrowd": 0,
                    "score": round(row.result.confidence, 4),
                    "status": row.result.status,
                }
            )
    return {
        "info": {"description": f"{clip.name}, tracked with MFCMT"},
        "videos": [{"id": 1, "name": clip.name, "width": clip.width, "height": clip.height, "fps": clip.fps}],
        "categories": [{"id": number, "name": kind} for kind, number in kinds.items()],
        "tracks": [{"id": t.id, "name": t.name, "category_id": kinds[t.kind], "video_id": 1} for t in tracks],
        "images": [images[frame] for frame in sorted(images)],
        "annotations": annotations,
    }
