"""What a service can do, what it accepts, and whether it takes work."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .enums import HealthStatus


@dataclass(frozen=True, slots=True)
class Limits:
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


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What this service can do."""

    protocol: int = field(metadata={"description": "version of the wire protocol"})
    subprotocols: tuple[str, ...]
    modes: tuple[str, ...]
    presets: tuple[str, ...]
    image_types: tuple[str, ...]
    trajectory_formats: tuple[str, ...]
    snapshot_versions: tuple[int, ...]
    limits: Limits
    software: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Health:
    """Whether the process lives, or takes work."""

    status: HealthStatus
    lanes_ready: int
    lanes: int
