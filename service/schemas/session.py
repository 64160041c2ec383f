"""Bodies and answers of the HTTP calls."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

Size = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Box = Annotated[
    tuple[FiniteFloat, FiniteFloat, Size, Size],
    Field(
        description="`[x, y, w, h]`: pixels of the whole frame after EXIF orientation, 0-based, top-left corner",
        examples=[[198, 214, 34, 81]],
    ),
]
Whole = Annotated[int, Field(ge=0, le=1 << 20)]
Positive = Annotated[int, Field(gt=0, le=1 << 20)]
Region = Annotated[
    tuple[Whole, Whole, Positive, Positive],
    Field(description="`[x, y, w, h]` in whole pixels of the frame", examples=[[120, 100, 190, 240]]),
]
Seq = Annotated[int, Field(ge=0, le=2**53 - 1, description="number of a frame message", examples=[17])]
Echo = Annotated[
    FiniteFloat | Annotated[str, Field(max_length=64)],
    Field(description="echoed, never interpreted", examples=[1712.5]),
]
Millis = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Preset = Literal["default", "paper"]
# Less is no time to send the next frame in.
LEAST_IDLE_S = 1.0


class Model(BaseModel):
    """Base: what is not named is not there."""

    model_config = ConfigDict(extra="forbid")


class Flags(Model):
    """The three tests of section III-C."""

    fused: bool
    template: bool
    statistical: bool


class Scores(Model):
    """Each peak over its mean of the last 10 frames."""

    fused: FiniteFloat
    template: FiniteFloat
    statistical: FiniteFloat


class Target(Model):
    """Where a target is and how far to trust it."""

    id: Annotated[int, Field(ge=0, description="unique in the session; the first is 0")]
    box: Box
    status: Literal["tracking", "uncertain", "lost"]
    reliable: Annotated[bool | None, Field(description="all three flags; null on the frame that started the target")]
    flags: Flags | None
    scores: Scores | None
    psr: Annotated[FiniteFloat | None, Field(description="peak-to-sidelobe ratio of the fused map")]
    updated: Annotated[bool, Field(description="whether the models learned from this frame")]
    scale: Annotated[float, Field(gt=0, description="size relative to the box given")]
    maps: Annotated[
        dict[str, str] | None,
        Field(default=None, description="response maps as grey PNG, base64 in JSON, where `maps` was asked for"),
    ]


class Timing(Model):
    """Milliseconds of the monotonic clock."""

    queue_ms: Millis
    decode_ms: Millis
    track_ms: Millis


class Result(Model):
    """What one tracked frame gave."""

    type: Literal["result"] = "result"
    seq: Seq
    ts: Echo | None
    size: tuple[Positive, Positive]
    dropped: Annotated[int, Field(ge=0, description="frames superseded since the previous result")]
    region: Region | None
    targets: list[Target]
    timing: Timing


class Stream(Model):
    """Where frames are streamed to."""

    url: str
    attached: bool


class Session(Model):
    """A session as it is now; `seq` is the last frame tracked."""

    id: str
    created_at: datetime
    expires_at: datetime
    label: str | None
    preset: Preset
    size: tuple[Positive, Positive]
    seq: Seq
    region: Region | None
    targets: list[Target]
    stream: Stream


class SessionPage(Model):
    """The caller's sessions, oldest first; `next` goes into `after`."""

    sessions: list[Session]
    next: str | None


class Options(Model):
    """How a session tracks and how long it waits."""

    model_config = ConfigDict(extra="forbid", strict=True)

    preset: Preset = "default"
    idle_timeout_s: Annotated[float | None, Field(ge=LEAST_IDLE_S, allow_inf_nan=False)] = None
    on_resize: Annotated[
        Literal["reject", "rescale"], Field(description="what a frame of another size does to the session")
    ] = "reject"
    label: Annotated[str | None, Field(max_length=200)] = None
    maps: Annotated[bool, Field(description="response maps in every result")] = False


class BoxBody(Model):
    """A box for a target."""

    box: Box


class TargetAnswer(Model):
    """A target that was added or corrected, and the region of coming frames."""

    target: Target
    region: Region | None


class TicketBody(Model):
    """How long the ticket is good."""

    model_config = ConfigDict(extra="forbid", strict=True)

    ttl_s: Annotated[float | None, Field(gt=0, allow_inf_nan=False)] = None


class TicketAnswer(Model):
    """One handshake: offer the subprotocol `mfcmt.ticket.TICKET` beside the one you speak."""

    ticket: str
    expires_at: datetime


class PastResult(Model):
    """One tracked frame of the past."""

    seq: Seq
    ts: Echo | None
    size: tuple[Positive, Positive]
    region: Region | None
    targets: list[Target]


class TrajectoryAnswer(Model):
    """Tracked frames by rising `seq`; the newest one as corrections left it."""

    id: str
    results: list[PastResult]


class Limits(Model):
    """What the service accepts."""

    max_frame_bytes: int
    max_frame_pixels: int
    max_frame_side_px: int
    max_frame_scans: int
    max_frame_scan_pixels: int
    max_json_frame_bytes: int
    max_body_bytes: int
    max_snapshot_bytes: int
    max_targets_per_session: int
    max_sessions_per_key: int
    max_streams_per_key: int
    max_trajectory_bytes: int
    idle_timeout_s: float
    max_idle_timeout_s: float
    attached_idle_timeout_s: float
    max_session_s: float
    operation_deadline_s: float
    credit_frames: int
    region_lag_frames: int
    max_messages_per_s: float
    max_requests_per_s: float
    max_frames_per_s_per_key: float
    max_frame_bytes_per_s_per_key: float
    ticket_s: float
    max_ticket_s: float


class Capabilities(Model):
    """What this service can do."""

    protocol: Annotated[int, Field(description="version of the wire protocol")]
    subprotocols: list[str]
    modes: list[str]
    presets: list[str]
    image_types: list[str]
    trajectory_formats: list[str]
    snapshot_versions: list[int]
    limits: Limits
    software: dict[str, str]


class Health(Model):
    """Whether the process lives, or takes work."""

    status: Literal["ok", "starting", "failing", "draining"]
    lanes_ready: int
    lanes: int


class Problem(BaseModel):
    """RFC 9457, with the code that programs decide by."""

    model_config = ConfigDict(extra="allow")

    type: str
    title: str
    status: Annotated[int, Field(ge=400, le=599)]
    detail: str
    code: str
    retry_after_s: Annotated[float, Field(ge=0)] = 0
