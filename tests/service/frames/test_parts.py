"""A lane decodes the part of a whole frame that its trackers look at, and answers as if it had decoded everything."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

from mfcmt_core import synthetic
from mfcmt_core.images import FrameInfo, FrameLimits
from mfcmt_core.images.decode import Image, decode_part
from service.lanes import lane_session
from service.lanes.limits import LaneLimits
from service.lanes.operations import LaneOperations
from service.lanes.rows import Rect
from service.load.clips import encode
from service.protocol.problems import ProblemError
from service.protocol.requests import Options

from .cost import every_pixel

SIZE, LENGTH = (800, 600), 12
FULL = (SIZE[1], SIZE[0])


class Lane:
    """A lane with one session; ``shapes`` has (rows, columns) of what was decoded of each frame with targets."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.shapes: list[tuple[int, ...]] = []
        self._operations = LaneOperations(LaneLimits(FrameLimits(), 10, 1))

        def noted(data: bytes, info: FrameInfo, needed: Rect) -> tuple[Image, tuple[int, int]]:
            found = decode_part(data, info, needed)
            self.shapes.append(found[0].shape[:2])
            return found

        monkeypatch.setattr(lane_session, "decode_part", noted)

    def create(self, frame: bytes, *boxes: Any) -> dict[str, Any]:
        options = asdict(Options())
        return self._do("create", {"options": options, "boxes": [list(map(float, box)) for box in boxes]}, frame)

    def track(self, seq: int, frame: bytes, **args: Any) -> dict[str, Any]:
        return self._do("track", {"seq": seq} | args, frame)

    def control(self, **args: Any) -> dict[str, Any]:
        return self._do("control", args, b"")

    def _do(self, op: str, args: dict[str, Any], frame: bytes) -> dict[str, Any]:
        state: dict[str, Any] = self._operations.handle(op, "session", args, frame)
        return {name: value for name, value in state.items() if name not in ("decode_s", "track_s")}


@pytest.fixture
def lane(monkeypatch: pytest.MonkeyPatch) -> Lane:
    return Lane(monkeypatch)


@pytest.fixture(scope="module")
def clip() -> tuple[list[bytes], list[Any]]:
    """Frames in JPEG and the boxes of their target."""
    found = synthetic.clip("motion", size=SIZE, target=(60.0, 50.0), length=LENGTH)
    return [encode(image) for image in found.frames], [list(box) for box in found.boxes]


def test_results_are_those_of_whole_frames(lane: Lane, clip: Any) -> None:
    frames, boxes = clip
    x, y, w, h = boxes[0]
    states = []
    for decode_all in (False, True):
        lane.create(frames[0], boxes[0], (x + 20, y + 10, w, h))
        if decode_all:
            with every_pixel():
                states.append([lane.track(seq, frame) for seq, frame in enumerate(frames[1:], 1)])
        else:
            states.append([lane.track(seq, frame) for seq, frame in enumerate(frames[1:], 1)])
    assert states[0] == states[1]
    assert len(lane.shapes) == LENGTH - 1
    assert all(rows < FULL[0] / 2 and columns < FULL[1] / 2 for rows, columns in lane.shapes)


def test_a_lost_target_is_searched_in_the_whole_frame(lane: Lane, clip: Any) -> None:
    frames, boxes = clip
    lane.create(frames[0], boxes[0])
    empty = encode(np.full((*FULL, 3), 128, np.uint8))
    for seq in range(1, 9):
        region = lane.track(seq, empty)["region"]
    assert region == (0, 0, *SIZE)
    assert lane.shapes[0] != FULL
    assert lane.shapes[-1] == FULL
    assert lane.track(9, frames[1])["rows"]


def test_a_target_may_start_anywhere_in_a_whole_frame(lane: Lane, clip: Any) -> None:
    frames, boxes = clip
    lane.create(frames[0], boxes[0])
    for seq, box in enumerate(((2, 2, 40, 40), (SIZE[0] - 42, SIZE[1] - 42, 40, 40)), 1):
        state = lane.track(seq, frames[seq], controls=[{"type": "add", "box": box}])
        assert state["answers"] == [None]
    assert len(state["rows"]) == 3
    assert lane.shapes == []


def test_damage_outside_the_part_is_refused_and_changes_nothing(lane: Lane, clip: Any) -> None:
    frames, boxes = clip
    before = lane.create(frames[0], boxes[0])
    for at in (0.3, 0.6, 0.9, 0.99):
        cut = frames[1][: int(len(frames[1]) * at)]
        for broken in (cut, cut + b"\xff\xd9"):
            with pytest.raises(ProblemError) as refused:
                lane.track(1, broken)
            assert refused.value.code == "frame-undecodable"
    assert lane.track(1, frames[0])["rows"][0][0] == before["rows"][0][0]
    assert lane.shapes[-1] != FULL


def test_a_target_that_is_added_later_starts_on_the_whole_newest_frame(lane: Lane, clip: Any) -> None:
    frames, boxes = clip
    lane.create(frames[0], boxes[0])
    lane.track(1, frames[1])
    assert lane.shapes[-1] != FULL
    for number, box in enumerate(((2, 2, 40, 40), (SIZE[0] - 42, SIZE[1] - 42, 40, 40)), 1):
        assert lane.control(type="add", box=box)["target"] == number
