"""A client's messages, checked by hand because it happens on every frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..problems import ProblemError
from ..schemas import fields

Echo = float | str | None


@dataclass(frozen=True, slots=True)
class Meta:
    """What a client says about a frame."""

    seq: int | None = None
    ts: Echo = None
    region: list[int] | None = None


@dataclass(frozen=True, slots=True)
class FrameMessage:
    """An encoded image and what was said about it; with ``problem`` it is refused, but was a frame."""

    data: bytes
    meta: Meta
    problem: ProblemError | None = None


@dataclass(frozen=True, slots=True)
class Control:
    """Add, correct or remove a target; ``command`` is what the lane is told."""

    command: dict[str, Any]
    ref: Echo
    on_next: bool


_ALLOWED = {
    "meta": {"type", "seq", "ts", "region"},
    "frame": {"type", "seq", "ts", "region", "frame"},
    "add": {"type", "box", "ref", "on"},
    "correct": {"type", "target", "box", "ref", "on"},
    "remove": {"type", "target", "ref", "on"},
}
CONTROLS = ("add", "correct", "remove")


def kind_of(message: dict[str, Any], known: tuple[str, ...]) -> str:
    """The message's type. Raises bad-request."""
    kind = message.get("type")
    if not isinstance(kind, str) or kind not in known:
        told = f"type is one of {', '.join(known)}"
        if kind == "frame":
            told += "; in mfcmt.v1.json a frame is a binary message, the image's bytes alone"
        raise ProblemError("bad-request", told)
    return kind


def meta(message: dict[str, Any]) -> Meta:
    """What is said about a frame. Raises bad-request, bad-region."""
    _check_names("meta", message)
    return Meta(
        fields.seq(message.get("seq")),
        fields.echo("ts", message.get("ts")),
        fields.region(message.get("region")),
    )


def frame(message: dict[str, Any]) -> FrameMessage:
    """A frame and what is said about it, in one map."""
    seq = None
    try:
        seq = fields.seq(message.get("seq"))
        _check_names("frame", message)
        data = message.get("frame")
        if type(data) is not bytes:
            raise ProblemError("bad-request", "frame is the image's bytes (bin), not text")
        return FrameMessage(data, Meta(seq, fields.echo("ts", message.get("ts")), fields.region(message.get("region"))))
    except ProblemError as problem:
        return FrameMessage(b"", Meta(seq), problem)


def control(kind: str, message: dict[str, Any]) -> Control:
    """A control. Raises bad-request, bad-box."""
    _check_names(kind, message)
    command: dict[str, Any] = {"type": kind}
    if kind != "add":
        command["target"] = fields.target(message.get("target"))
    if kind != "remove":
        command["box"] = fields.box(message.get("box"))
    on = message.get("on")
    if on not in (None, "next"):
        raise ProblemError("bad-request", 'on is "next" or absent')
    return Control(command, fields.echo("ref", message.get("ref")), on == "next")


def echoed_ref(message: dict[str, Any]) -> Echo:
    """The ``ref`` of a message that may be wrong in any other way."""
    try:
        return fields.echo("ref", message.get("ref"))
    except ProblemError:
        return None


def _check_names(kind: str, message: dict[str, Any]) -> None:
    if unknown := message.keys() - _ALLOWED[kind]:
        raise ProblemError("bad-request", f"{kind} has no field {sorted(map(str, unknown))[0][:40]!r}")
