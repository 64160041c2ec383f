"""YOLO: a text file a frame, with class, centre and size as shares of the frame."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path, PurePath

from .rows import Clip, Row, by_target, seen


def yolo(folder: Path, clip: Clip, rows: Iterable[Row]) -> None:
    """Write ``labels/*.txt`` and ``data.yaml`` into ``folder``. A frame without a visible target has an empty file.

    Lines are ``class x y w h``; the numbers of tracks have no place in this format. Raises OSError.
    """
    tracks = by_target(rows)
    kinds = list(dict.fromkeys(target.kind for target in tracks))
    lines: dict[int, list[str]] = {}
    for target, path in tracks.items():
        for row in path:
            of_frame = lines.setdefault(row.frame, [])
            box = seen(clip, row)
            if box is not None:
                x, y, w, h = box
                shares = ((x + w / 2) / clip.width, (y + h / 2) / clip.height, w / clip.width, h / clip.height)
                numbers = " ".join(f"{share:.6f}" for share in shares)
                of_frame.append(f"{kinds.index(target.kind)} {numbers}\n")
    (folder / "labels").mkdir(parents=True, exist_ok=True)
    for frame, of_frame in lines.items():
        name = PurePath(clip.image(frame)).stem
        (folder / "labels" / f"{name}.txt").write_text("".join(of_frame), encoding="utf-8")
    names = "".join(f"  {number}: {json.dumps(kind)}\n" for number, kind in enumerate(kinds))
    text = f"path: {json.dumps(str(folder.absolute()))}\ntrain: images\nval: images\nnames:\n{names}"
    (folder / "data.yaml").write_text(text, encoding="utf-8")
