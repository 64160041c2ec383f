"""Messages of a stream, as the AsyncAPI document shows them.

What arrives is read by hand (``service.stream.messages``), because it happens on every frame; a test holds
the two together.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from .session import Box, Echo, Model, Problem, Region, Result, Seq, Session, Target

Ref = Annotated[Echo | None, Field(default=None, description="echoed in the answer")]
OnNext = Annotated[
    Literal["next"] | None,
    Field(default=None, description="act on the next frame message instead of the newest tracked frame"),
]
TargetId = Annotated[int, Field(ge=0, le=2**53 - 1)]


class Meta(Model):
    """Said before a frame (json subprotocol): it belongs to the next binary message."""

    type: Literal["meta"]
    seq: Seq | None = None
    ts: Echo | None = None
    region: Region | None = None


class FrameMessage(Model):
    """A frame (msgpack subprotocol); in the json subprotocol a frame is a binary message of its own."""

    type: Literal["frame"]
    frame: Annotated[str, Field(json_schema_extra={"format": "binary"}, description="JPEG, PNG or WebP; bin")]
    seq: Seq | None = None
    ts: Echo | None = None
    region: Region | None = None


class Add(Model):
    """Start another target."""

    type: Literal["add"]
    box: Box
    ref: Ref
    on: OnNext


class Correct(Model):
    """Start a target anew."""

    type: Literal["correct"]
    target: TargetId
    box: Box
    ref: Ref
    on: OnNext


class Remove(Model):
    """Stop following a target."""

    type: Literal["remove"]
    target: TargetId
    ref: Ref
    on: OnNext


class Ready(Model):
    """The first message of the server, once."""

    type: Literal["ready"]
    session: Session
    mode: Literal["latest", "lossless"]
    credit: Annotated[int | None, Field(description="unanswered frames allowed; null in `latest`")]
    region_lag: Annotated[int, Field(ge=0, description="frames in flight that regions leave room for")]
    next_seq: Annotated[Seq, Field(description="the number that the next frame takes")]
    attachment: Annotated[str, Field(description="name of this attachment, for `resume`")]
    lost_after: Annotated[
        Seq | None,
        Field(
            default=None,
            description="after a breakdown of the service, until a frame is tracked: the last frame that the session"
            " knows; what it learned from later ones is lost",
        ),
    ]


class Error(Model):
    """A message was refused and nothing changed; the stream goes on."""

    type: Literal["error"]
    seq: Seq | None = None
    ref: Ref
    problem: Problem


class Targets(Model):
    """After a control, or after a change over HTTP."""

    type: Literal["targets"]
    ref: Ref
    region: Region | None
    targets: list[Target]


class Draining(Model):
    """The server is going away; where sessions outlive it, they are resumed under the same id."""

    type: Literal["draining"]
    reconnect_in_s: Annotated[float, Field(ge=0)]
    resumable: Annotated[bool, Field(description="sessions outlive the process: it has a state directory")]


CLIENT = (Meta, FrameMessage, Add, Correct, Remove)
SERVER = (Ready, Result, Error, Targets, Draining)
