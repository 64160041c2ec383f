"""Where the time of one frame went."""

from __future__ import annotations

from typing import NamedTuple


class Stages(NamedTuple):
    """Seconds of each stage, in the order of the way of a frame; their sum is arrival to result."""

    receive: float
    """From the whole message in the front to its place in the queue: parsed, checked, numbered."""
    queue: float
    """Waiting for the session: for the frame or the control before it."""
    transit: float
    """To the lane and back: its queue, where sessions wait for each other, and both sockets."""
    decode: float
    """In the lane: header limits and pixels."""
    track: float
    """In the lane: all targets."""
