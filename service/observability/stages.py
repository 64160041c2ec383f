"""The stages of a frame's way through the service."""

from __future__ import annotations

from typing import NamedTuple


class Stages(NamedTuple):
    """Seconds that a frame spent in each stage, in order. Their sum is the time from arrival to result."""

    receive: float
    """From the complete message in the front to its place in the queue: parsing, checks, numbering."""
    queue: float
    """Waiting for the frame or control before it in the session."""
    transit: float
    """To the lane and back: both sockets, and the lane's queue, where sessions wait for each other."""
    decode: float
    """In the lane: checks of the header, and decoding."""
    track: float
    """In the lane: tracking of all targets."""
