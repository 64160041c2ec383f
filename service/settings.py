"""Settings of the service, read from ``MFCMT_*`` variables. The unit of a setting is in its name."""

from __future__ import annotations

import os
import re
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, SecretStr, field_validator, model_validator
from pydantic_settings import (
    BaseSettings,
    EnvSettingsSource,
    NoDecode,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
)

from mfcmt_core.cli.variables import OWN, PREFIX, unread_variables

from . import environment
from .bridges import BRIDGES
from .certificate import check_pair
from .container import budget_bytes
from .hosts import LOCAL
from .keys import LEAST_CHARACTERS, check_key, read_keys
from .lanes.cores import default_lanes

MIB = 1024 * 1024
TEN_YEARS_S = 3.2e8
# Apps in a WebView have origins of other schemes than http.
ORIGIN = re.compile(r"[a-z][a-z0-9+.-]*://[^\s/?#@*\\]+", re.IGNORECASE)
HOST = re.compile(r"[A-Za-z0-9._-]+(?::[0-9]{1,5})?")
STORES = ("redis://", "rediss://", "unix://")
NODE = re.compile(r"[a-z0-9](?:[a-z0-9-]{0,61}[a-z0-9])?")
# Variables that the exporter of spans reads by itself; they may hold a key.
OTLP_HEADERS = ("OTEL_EXPORTER_OTLP_HEADERS", "OTEL_EXPORTER_OTLP_TRACES_HEADERS")
Secrets = Annotated[tuple[SecretStr, ...], NoDecode]
Names = Annotated[tuple[str, ...], NoDecode]


def _positive(default: float, description: str, most: float = TEN_YEARS_S) -> Any:
    return Field(default=default, gt=0, le=most, allow_inf_nan=False, description=description)


def unread_settings() -> list[str]:
    """Return a line for each ``MFCMT_*`` variable that is no setting, with the nearest name that is one."""
    return unread_variables(f"MFCMT_{name.upper()}" for name in Settings.model_fields)


class Settings(BaseSettings):
    """Settings of one server process. Lists are separated by commas."""

    model_config = SettingsConfigDict(env_prefix="MFCMT_", extra="ignore", frozen=True, hide_input_in_errors=True)

    host: str = Field(default="127.0.0.1", description="address to listen on")
    port: int = Field(default=8000, ge=0, le=65535, description="port to listen on; 0 takes a free one")
    public_url: str = Field(default="", description="base URL that clients see, where a proxy does not pass it on")
    tls_certificate: Path | None = Field(
        default=None, description="PEM file of the certificate; the service then speaks https and wss alone"
    )
    tls_key: Path | None = Field(default=None, description="PEM file of the certificate's key, without a password")

    lanes: int = Field(
        default_factory=default_lanes,
        ge=1,
        le=256,
        description="worker processes; default: the cores that affinity and cgroup leave, less one from three cores on",
    )
    max_sessions_per_lane: int = Field(
        default=16, ge=1, description="sessions in one lane; the service holds lanes times this"
    )
    max_sessions_per_key: int | None = Field(
        default=None,
        ge=1,
        description="sessions of one key; default: all, or half of all where there are several keys",
    )
    max_targets_per_session: int = Field(default=16, ge=1, le=256, description="targets in one session")
    region_lag_frames: int = Field(default=1, ge=0, le=30, description="frames in flight that a region leaves room for")
    operation_deadline_s: float = _positive(5.0, "time of one operation; a lane that takes longer is replaced")
    max_lane_rss_bytes: int = Field(
        default=1536 * MIB, ge=256 * MIB, description="resident memory of one lane; a lane that outgrows it is replaced"
    )
    lane_start_timeout_s: float = _positive(180.0, "time from the start of a lane until it is ready")

    checkpoint_every_frames: int = Field(
        default=30, ge=1, le=10_000, description="frames of a session between two checkpoints of its state"
    )
    max_replay_bytes: int = Field(
        default=16 * MIB, ge=64 * 1024, description="frames kept of one session since its checkpoint"
    )
    max_recovery_bytes: int = Field(
        default=512 * MIB, ge=MIB, description="checkpoints and frames kept of all sessions"
    )
    recovery_timeout_s: float = _positive(30.0, "calls of a session whose lane is lost are refused after this long")
    state_dir: str = Field(default="", description="directory where sessions outlive the process; default: they do not")

    store: SecretStr | None = Field(
        default=None,
        description="Redis or Valkey that several nodes share, as redis://host:6379/0 or rediss:// or unix://; "
        "default: this is the only node (docs/scaling.md)",
    )
    node: str = Field(default="", description="name of this node among those that share a store, as a DNS label")
    node_url: str = Field(default="", description="base URL by which clients and the other nodes reach this very node")
    store_every_s: float = _positive(5.0, "a session that changes is saved to the store once in this time")
    store_grace_s: float = _positive(30.0, "new sessions are refused when the store is away for longer")

    max_frame_bytes: int = Field(default=8 * MIB, ge=1024, description="bytes of one encoded frame")
    max_frame_pixels: int = Field(
        default=8_300_000, ge=1, le=1 << 26, description="pixels of one frame, from its header"
    )
    max_frame_side_px: int = Field(default=8192, ge=1, le=65535, description="width or height of one frame")
    max_frame_scans: int = Field(default=16, ge=1, description="scans of one progressive JPEG")
    max_frame_scan_pixels: int = Field(
        default=25_000_000, ge=1, description="pixels times scans of one JPEG with more than one scan"
    )
    max_json_frame_bytes: int = Field(
        default=256 * 1024, ge=1024, description="bytes of a frame that is base64 in JSON"
    )
    max_body_bytes: int = Field(default=64 * 1024, ge=1024, description="bytes of a body or message without a frame")
    max_snapshot_bytes: int = Field(default=64 * MIB, ge=1024, description="bytes of a snapshot that a client sends")
    max_upload_bytes: int = Field(
        default_factory=budget_bytes,
        ge=1024,
        description="bytes under way at once: bodies, messages, waiting frames, unread answers",
    )
    body_timeout_s: float = _positive(30.0, "time from a call's head to the end of its body")

    idle_timeout_s: float = _positive(300.0, "a session without a stream ends after this long without a frame or call")
    max_idle_timeout_s: float = _positive(3600.0, "maximum of a client's idle_timeout_s")
    attached_idle_timeout_s: float = _positive(600.0, "the same for a session with a stream")
    max_session_s: float = _positive(86400.0, "a session ends after this long however busy")
    tombstone_s: float = _positive(3600.0, "an ended session answers 410 for this long")
    max_tombstones: int = Field(default=10_000, ge=0, description="ended sessions of one key that are remembered")
    max_trajectory_bytes: int = Field(
        default=8 * MIB, ge=4096, description="past results kept in one session; the oldest go first"
    )
    idempotency_s: float = _positive(600.0, "an Idempotency-Key is remembered for this long")
    max_idempotency_keys: int = Field(
        default=10_000, ge=0, description="Idempotency-Keys of one key that are remembered"
    )

    credit_frames: int = Field(default=4, ge=1, le=64, description="unanswered frames of a lossless stream")
    max_messages_per_s: float = _positive(2000.0, "messages of one session; as many again may come at once")
    max_control_frames_per_s: float = _positive(
        100.0,
        "pings, pongs and fragments below 1 KiB of one stream; as many again at once; more cut it",
    )
    max_refusals_per_s: float = _positive(
        200.0, "refusals of one key, and of all clients without one; beyond it streams end and calls wait"
    )
    max_requests_per_s: float = _positive(1000.0, "HTTP calls of one key; as many again may come at once")
    max_frames_per_s: float = _positive(10_000.0, "frames of all keys; as many again may come at once")
    max_frames_per_s_per_key: float = _positive(5000.0, "frames of one key; as many again may come at once")
    max_frame_bytes_per_s: float = _positive(512.0 * MIB, "bytes of frames and snapshots of all keys", 1e12)
    max_frame_bytes_per_s_per_key: float = _positive(256.0 * MIB, "bytes of frames and snapshots of one key", 1e12)
    max_streams: int = Field(default=2048, ge=1, description="attached streams")
    max_streams_per_key: int | None = Field(
        default=None,
        ge=1,
        description="attached streams of one key; default: all, or half where there are several keys",
    )
    max_refused_messages: int = Field(
        default=200, ge=1, description="messages in a row that are refused for their rate before a stream closes"
    )
    send_timeout_s: float = _positive(20.0, "a stream whose client does not read closes after this long")
    ping_interval_s: float = _positive(20.0, "time between pings on a stream")
    ping_timeout_s: float = _positive(20.0, "time for the pong")
    max_connections: int = Field(
        default=4096,
        ge=1,
        description="open connections; more are refused with at-capacity, above twice this cut",
    )
    max_head_bytes: int = Field(default=32 * 1024, ge=1024, description="bytes of a call's request line and headers")
    head_timeout_s: float = _positive(10.0, "time from the first byte of a connection or call to the end of its head")
    drain_grace_s: float = Field(
        default=15.0,
        ge=0,
        allow_inf_nan=False,
        description="time after SIGTERM for work in flight and, without a state directory, for open streams",
    )

    api_keys: Secrets = Field(default=(), description="keys that clients must send; default: no authentication")
    api_keys_file: Path | None = Field(
        default=None, description="file of more keys, one per line as KEY or NAME KEY; read again when it changes"
    )
    admin_key: SecretStr | None = Field(
        default=None, description="key for /metrics, at least 16 characters; default: none is needed"
    )
    allow_unauthenticated: bool = Field(default=False, description="allow listening beyond loopback without keys")
    allowed_origins: Names = Field(
        default=(),
        description="browser origins besides the service's own, as https://host:port or, of apps, "
        "capacitor://localhost; localhost alone: every page of the browser's own machine, for development",
    )
    ticket_s: float = _positive(30.0, "a ticket is valid for this long")
    max_ticket_s: float = _positive(300.0, "maximum of a client's ttl_s")
    max_tickets: int = Field(default=10_000, ge=1, description="tickets of one key that wait for their handshake")
    signing_keys: Secrets = Field(default=(), description="keys that sign snapshots: the first signs, all verify")

    log_format: Literal["auto", "json", "console"] = Field(
        default="auto", description="json, console, or auto, which is console on a terminal"
    )
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        default="info", description="lowest level that is logged"
    )

    bridges: Names = Field(
        default=(),
        description=f"interfaces of other tools that are opened: {', '.join(BRIDGES)} (docs/integrations.md)",
    )
    video_hosts: Names = Field(
        default=(),
        description="hosts, as name or name:port, from which the bridge to Label Studio fetches videos; default: none",
    )
    max_video_bytes: int = Field(default=512 * MIB, ge=1024, description="bytes of a video that a bridge fetches")

    otlp_endpoint: str = Field(
        default="",
        description="base URL of the OTLP/HTTP collector of spans, as http://host:4318; default: no spans",
    )
    trace_ratio: float = Field(
        default=0.01, ge=0, le=1, allow_inf_nan=False, description="share of calls and frames that begin a trace"
    )

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],  # noqa: ARG003
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,  # noqa: ARG003
        file_secret_settings: PydanticBaseSettingsSource,  # noqa: ARG003
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Read arguments, then the environment and the variables that :meth:`leave_environment` removed from it."""
        assert isinstance(env_settings, EnvSettingsSource)
        env_settings.env_vars = {**environment.taken(), **env_settings.env_vars}
        return init_settings, env_settings

    @classmethod
    def leave_environment(cls) -> None:
        """Remove every variable of the settings, misspelt ones too, from the environment: no lane inherits a key."""
        environment.take({name for name in map(str.upper, os.environ) if name.startswith(PREFIX)} - set(OWN))
        environment.take(OTLP_HEADERS)

    @field_validator("api_keys", "signing_keys", "allowed_origins", "bridges", "video_hosts", mode="before")
    @classmethod
    def _split(cls, value: Any) -> Any:
        if isinstance(value, str):
            return tuple(part for part in (p.strip() for p in value.split(",")) if part)
        return value

    @field_validator("api_keys")
    @classmethod
    def _usable_keys(cls, value: tuple[SecretStr, ...]) -> tuple[SecretStr, ...]:
        for secret in value:
            check_key(secret.get_secret_value())
        return value

    @field_validator("admin_key")
    @classmethod
    def _usable_admin_key(cls, value: SecretStr | None) -> SecretStr | None:
        if value is not None:
            if not value.get_secret_value():
                raise ValueError("is empty: set a key, or unset the variable to leave /metrics open")
            check_key(value.get_secret_value())
        return value

    @field_validator("signing_keys")
    @classmethod
    def _long_enough(cls, value: tuple[SecretStr, ...]) -> tuple[SecretStr, ...]:
        if any(len(secret.get_secret_value()) < LEAST_CHARACTERS for secret in value):
            raise ValueError(f"a key has at least {LEAST_CHARACTERS} characters")
        return value

    @field_validator("api_keys_file")
    @classmethod
    def _readable(cls, value: Path | None) -> Path | None:
        if value is not None:
            read_keys(value)
        return value

    @field_validator("allowed_origins")
    @classmethod
    def _bare_origins(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for origin in value:
            if not ORIGIN.fullmatch(origin) and origin.lower() != LOCAL:
                examples = "https://app.example:8443 or capacitor://localhost (or localhost alone, for development)"
                raise ValueError(f"an origin is scheme://host[:port] and nothing more, as {examples}")
        return tuple(origin.lower() for origin in value)

    @field_validator("bridges")
    @classmethod
    def _known_bridges(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for name in value:
            if name not in BRIDGES:
                raise ValueError(f"there is no bridge {name[:40]!r}; there are {', '.join(BRIDGES)}")
        return value

    @field_validator("video_hosts")
    @classmethod
    def _bare_hosts(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for host in value:
            if not HOST.fullmatch(host):
                raise ValueError("a host is its name or address, and a port if need be, as videos.example:8443")
        return tuple(host.lower() for host in value)

    @field_validator("store")
    @classmethod
    def _store_url(cls, value: SecretStr | None) -> SecretStr | None:
        if value is not None and not value.get_secret_value().startswith(STORES):
            raise ValueError(f"starts with {', '.join(STORES)}")
        return value

    @field_validator("node")
    @classmethod
    def _node_name(cls, value: str) -> str:
        if value and not NODE.fullmatch(value):
            raise ValueError("a name has at most 63 of a-z, 0-9 and -, and neither begins nor ends with -, as node-1")
        return value

    @field_validator("public_url", "node_url", "otlp_endpoint")
    @classmethod
    def _http_url(cls, value: str) -> str:
        if value and not value.startswith(("http://", "https://")):
            raise ValueError("starts with http:// or https://")
        return value.rstrip("/")

    @model_validator(mode="after")
    def _keys_beyond_loopback(self) -> Settings:
        if not (self.authenticated or self.allow_unauthenticated or self.on_loopback):
            raise ValueError("host is not a loopback address: set MFCMT_API_KEYS, or MFCMT_ALLOW_UNAUTHENTICATED=true")
        return self

    @model_validator(mode="after")
    def _certificate_with_key(self) -> Settings:
        if (self.tls_certificate is None) != (self.tls_key is None):
            raise ValueError("MFCMT_TLS_CERTIFICATE and MFCMT_TLS_KEY go together: set both, or none")
        if self.tls_certificate and self.tls_key:
            check_pair(self.tls_certificate, self.tls_key)
        return self

    @model_validator(mode="after")
    def _nodes_have_names(self) -> Settings:
        if self.store is None:
            if self.node or self.node_url:
                raise ValueError("MFCMT_NODE and MFCMT_NODE_URL are for nodes that share a store: set MFCMT_STORE")
        elif not (self.node and self.node_url):
            raise ValueError("MFCMT_STORE needs MFCMT_NODE and MFCMT_NODE_URL, by which the other nodes know this one")
        elif self.state_dir:
            raise ValueError("MFCMT_STORE and MFCMT_STATE_DIR are two places for the same sessions: set one of them")
        return self

    @property
    def authenticated(self) -> bool:
        """Whether clients must show a key."""
        return bool(self.api_keys or self.api_keys_file)

    @property
    def on_loopback(self) -> bool:
        """Whether only this machine can connect."""
        try:
            return ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    @property
    def capacity(self) -> int:
        """Sessions that the service holds at once."""
        return self.lanes * self.max_sessions_per_lane
