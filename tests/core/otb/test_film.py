"""Strips and videos of several trackers' boxes."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from mfcmt_core.otb import open_otb
from mfcmt_core.otb.document import PALETTE
from mfcmt_core.otb.film import STRIP_WIDTH, strip, video


def test_a_strip_shows_each_trackers_box_in_its_colour(otb_root: Path) -> None:
    deer = open_otb(otb_root)["Deer"]
    boxes = {
        "here": deer.boxes + np.array([40, 40, 0, 0]),
        "lost": np.full((71, 4), np.nan),
        "there": deer.boxes,
    }
    image = strip(deer, boxes, frames=4)
    height = round(deer.image_size[1] * STRIP_WIDTH / deer.image_size[0])  # type: ignore[index]
    assert image.shape[1] == 3 * STRIP_WIDTH
    assert 2 * height < image.shape[0] < 2 * height + 60  # two rows and a legend
    for index, seen in ((0, True), (1, False), (2, True)):
        red, green, blue = (int(PALETTE[index][i : i + 2], 16) for i in (1, 3, 5))
        pixels = np.abs(image[: 2 * height].astype(int) - [blue, green, red]).sum(axis=2) < 12
        assert (pixels.sum() > 200) == seen


def test_a_video_has_every_frame(otb_root: Path, tmp_path: Path) -> None:
    football = open_otb(otb_root)["Football1"]
    video(tmp_path / "film.mp4", football, {f"tracker {i}": football.boxes for i in range(12)})
    film = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    frames = 0
    while film.read()[0]:
        frames += 1
    assert frames == len(football)
