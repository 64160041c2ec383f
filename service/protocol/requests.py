"""What a client sends: the messages of a stream and the fields of HTTP bodies.

Each field of a stream's message has its check beside its type. A check refuses with a text that says what to send
instead, and costs less than a validation library does, on a path that every frame takes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cache, partial
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args, get_type_hints

from .enums import Preset, ProblemCode, Resize
from .problems import ProblemError
from .values import (
    BOX_DOC,
    ECHO_DOC,
    REF_DOC,
    REGION_DOC,
    SEQ_DOC,
    Box,
    Echo,
    Region,
    Seq,
    check_box,
    check_echo,
    check_region,
    check_seq,
    check_target,
)

T = TypeVar("T")

# Less leaves no time to send the next frame in.
LEAST_IDLE_S = 1.0
ON_DOC = {"description": "act on the next frame message instead of the newest tracked frame"}


@dataclass(frozen=True, slots=True)
class Check:
    """Stands beside a field's type: ``read`` returns the field's value, None where it is absent, or refuses."""

    read: Callable[[Any], Any]


def _check_on(value: Any) -> Any:
    if value not in (None, "next"):
        raise ProblemError(ProblemCode.BAD_REQUEST, 'on is "next" or absent')
    return value


def _check_image(value: Any) -> Any:
    if type(value) is not bytes:
        raise ProblemError(ProblemCode.BAD_REQUEST, "frame is the image's bytes (bin), not text")
    return value


Image = Annotated[bytes, Check(_check_image)]
SentBox = Annotated[Box, Check(check_box)]
SentSeq = Annotated[Seq | None, Check(check_seq)]
SentTs = Annotated[Echo | None, Check(partial(check_echo, "ts"))]
SentRegion = Annotated[Region | None, Check(check_region)]
SentTarget = Annotated[Seq, Check(check_target)]
Ref = Annotated[Echo | None, Check(partial(check_echo, "ref"))]
On = Annotated[Literal["next"] | None, Check(_check_on)]


@dataclass(frozen=True, slots=True)
class Meta:
    """Said before a frame (json subprotocol): it belongs to the next binary message."""

    TYPE: ClassVar = "meta"

    seq: SentSeq = field(default=None, metadata=SEQ_DOC)
    ts: SentTs = field(default=None, metadata=ECHO_DOC)
    region: SentRegion = field(default=None, metadata=REGION_DOC)


@dataclass(frozen=True, slots=True)
class FrameMessage:
    """A frame (msgpack subprotocol); in the json subprotocol a frame is a binary message of its own."""

    TYPE: ClassVar = "frame"

    frame: Image = field(metadata={"description": "JPEG, PNG or WebP; bin"})
    seq: SentSeq = field(default=None, metadata=SEQ_DOC)
    ts: SentTs = field(default=None, metadata=ECHO_DOC)
    region: SentRegion = field(default=None, metadata=REGION_DOC)


@dataclass(frozen=True, slots=True)
class Add:
    """Start another target."""

    TYPE: ClassVar = "add"

    box: SentBox = field(metadata=BOX_DOC)
    ref: Ref = field(default=None, metadata=REF_DOC)
    on: On = field(default=None, metadata=ON_DOC)


@dataclass(frozen=True, slots=True)
class Correct:
    """Start a target anew."""

    TYPE: ClassVar = "correct"

    target: SentTarget = field(metadata={"description": "the target's `id`"})
    box: SentBox = field(metadata=BOX_DOC)
    ref: Ref = field(default=None, metadata=REF_DOC)
    on: On = field(default=None, metadata=ON_DOC)


@dataclass(frozen=True, slots=True)
class Remove:
    """Stop following a target."""

    TYPE: ClassVar = "remove"

    target: SentTarget = field(metadata={"description": "the target's `id`"})
    ref: Ref = field(default=None, metadata=REF_DOC)
    on: On = field(default=None, metadata=ON_DOC)


Control = Add | Correct | Remove
CONTROLS: dict[str, type[Control]] = {kind.TYPE: kind for kind in (Add, Correct, Remove)}
STREAM_MESSAGES = (Meta, FrameMessage, Add, Correct, Remove)
"""The messages that the service may receive in a stream."""


@dataclass(frozen=True, slots=True)
class Options:
    """How a session tracks and how long it waits."""

    __pydantic_config__: ClassVar = {"extra": "forbid"}

    preset: Preset = field(
        default=Preset.DEFAULT, metadata={"description": "configuration of the tracker: `default` or `paper`"}
    )
    idle_timeout_s: float | None = field(
        default=None,
        metadata={
            "ge": LEAST_IDLE_S,
            "allow_inf_nan": False,
            "strict": True,
            "description": "seconds without a frame or call after which the session ends",
        },
    )
    on_resize: Resize = field(
        default=Resize.REJECT,
        metadata={"description": "what a frame of another size does to the session: `reject` or `rescale`"},
    )
    label: str | None = field(
        default=None, metadata={"max_length": 200, "strict": True, "description": "echoed; at most 200 characters"}
    )
    maps: bool = field(default=False, metadata={"description": "response maps in every result", "strict": True})


@dataclass(frozen=True, slots=True)
class BoxBody:
    """A box for a target."""

    box: SentBox = field(metadata=BOX_DOC)


@dataclass(frozen=True, slots=True)
class TicketBody:
    """How long the ticket is good."""

    __pydantic_config__: ClassVar = {"extra": "forbid"}

    ttl_s: float | None = field(default=None, metadata={"gt": 0, "allow_inf_nan": False, "strict": True})


@cache
def _definition(kind: Any) -> tuple[frozenset[str], tuple[tuple[str, Callable[[Any], Any]], ...]]:
    """Return the names that a message may have, and its fields with their checks."""
    hints = get_type_hints(kind, include_extras=True)
    checks = tuple(
        (one.name, next(found.read for found in get_args(hints[one.name]) if isinstance(found, Check)))
        for one in fields(kind)
    )
    return frozenset(name for name, _ in checks) | ({"type"} if hasattr(kind, "TYPE") else set()), checks


def read(kind: type[T], sent: Mapping[str, Any]) -> T:
    """Return the message of the class ``kind`` that a client sent as the map ``sent``.

    Raises
    ------
    ProblemError
        A field is unknown (bad-request), or its check refuses.
    """
    names, checks = _definition(kind)  # type: ignore[arg-type]
    if not names.issuperset(sent):
        unknown = sorted(str(name) for name in sent if name not in names)[0][:40]
        raise ProblemError(ProblemCode.BAD_REQUEST, f"{getattr(kind, 'TYPE', 'the body')} has no field {unknown!r}")
    return kind(*[check(sent.get(name)) for name, check in checks])


def command(control: Control) -> dict[str, Any]:
    """Return what a lane does for ``control``: its type, and its target and box where it has them."""
    done: dict[str, Any] = {"type": control.TYPE}
    if not isinstance(control, Add):
        done["target"] = control.target
    if not isinstance(control, Remove):
        done["box"] = control.box
    return done
