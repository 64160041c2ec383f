"""What users of the client meet: the protocol's own types, and those of the client alone.

Fields that a newer service adds are ignored.
"""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from typing import Any, Literal, TypeVar

from ..protocol.answers import (
    Draining,
    PastResult,
    Ready,
    Result,
    SessionInfo,
    TargetChange,
    Targets,
    Ticket,
    Timing,
)
from ..protocol.enums import Status
from ..protocol.schema import adapter
from ..protocol.target import Flags, Scores, Target
from ..protocol.values import Box, Region, Size

__all__ = [
    "Box",
    "Draining",
    "Flags",
    "Frame",
    "Image",
    "Mode",
    "PastResult",
    "Ready",
    "Region",
    "Result",
    "Resumed",
    "Scores",
    "SessionInfo",
    "Size",
    "Status",
    "Target",
    "TargetChange",
    "Targets",
    "Ticket",
    "Timing",
    "read_answer",
    "read_past_result",
]

T = TypeVar("T")

Image = bytes | bytearray | memoryview | PathLike[str]
"""An encoded image (JPEG, PNG or WebP), or the path of its file."""

Mode = Literal["latest", "lossless"]
"""How a stream treats frames that arrive faster than they are tracked."""


@dataclass(frozen=True, slots=True)
class Frame:
    """An encoded frame and what is said about it.

    Parameters
    ----------
    data
        The encoded image.
    ts
        Echoed in the result and never interpreted.
    region
        The part of the frame that ``data`` shows; None for the whole.
    seq
        The frame's number; by default the client counts on.
    """

    data: bytes
    ts: float | str | None = None
    region: Region | None = None
    seq: int | None = None


@dataclass(frozen=True, slots=True)
class Resumed:
    """A stream goes on after its connection broke.

    Parameters
    ----------
    seq
        The last frame that the session knows.
    down_s
        How long the stream was interrupted, in seconds.
    lost_after
        None when nothing is lost. Else the service broke down: the results with a higher ``seq`` that the stream has
        given stand, but the trackers have forgotten what they learned from those frames.
    """

    seq: int
    down_s: float
    lost_after: int | None


def read_answer(kind: type[T], answer: Any) -> T:
    """Return an answer or message of the service as the type that defines it. Raises ValueError."""
    for target in answer.get("targets", ()):
        _decode_maps(target)
    if "target" in answer:
        _decode_maps(answer["target"])
    return adapter(kind).validate_python(answer)


def read_past_result(answer: Any) -> Result:
    """Return an entry of a trajectory as the result that it was."""
    past = read_answer(PastResult, answer)
    return Result(past.seq, past.ts, past.size, 0, past.region, past.targets, None)


def _decode_maps(target: Any) -> None:
    """Replace response maps that are base64, as in JSON, by their bytes."""
    maps: Mapping[str, Any] | None = target.get("maps")
    if maps:
        target["maps"] = {name: b64decode(image) if isinstance(image, str) else image for name, image in maps.items()}
