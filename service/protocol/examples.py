"""One example of each message and body, for both contracts; the tests check them against the definitions."""

from __future__ import annotations

from typing import Any

from .codecs import CODECS
from .enums import IMAGE_TYPES, VERSION, Mode, Preset, ProblemCode, TrajectoryFormat
from .problems import CATALOGUE, ProblemError

SESSION_ID = "u3kQ9c0yT1mVb5Zr7XwLhN2d"
BOX = [198, 214, 34, 81]
REGION = [124, 110, 182, 288]

STARTED = {
    "id": 0,
    "box": [198.0, 214.0, 34.0, 81.0],
    "status": "tracking",
    "reliable": None,
    "flags": None,
    "scores": None,
    "psr": None,
    "updated": True,
    "scale": 1.0,
    "confidence": 1.0,
}
TARGET = STARTED | {
    "box": [201.4, 213.2, 34.7, 82.6],
    "reliable": True,
    "flags": {"fused": True, "template": True, "statistical": True},
    "scores": {"fused": 1.04, "template": 1.02, "statistical": 0.97},
    "psr": 14.2,
    "scale": 1.02,
    "confidence": 0.93,
}
SESSION = {
    "id": SESSION_ID,
    "created_at": "2026-11-23T08:30:00.000Z",
    "expires_at": "2026-11-23T08:35:00.000Z",
    "label": "court 3",
    "preset": "default",
    "size": [576, 432],
    "seq": 0,
    "region": REGION,
    "targets": [STARTED],
    "stream": {"url": f"ws://127.0.0.1:8000/v1/sessions/{SESSION_ID}/stream", "attached": False},
}
PAGE = {"sessions": [SESSION], "next": None}
RESULT = {
    "type": "result",
    "seq": 17,
    "ts": 1712.5,
    "size": [576, 432],
    "dropped": 0,
    "region": REGION,
    "targets": [TARGET],
    "timing": {"queue_ms": 0.21, "decode_ms": 0.84, "track_ms": 0.97},
}
TARGET_ANSWER = {"target": STARTED, "region": REGION}
TICKET = {"ticket": "c2V2ZW50ZWVuLWJ5dGVzLW9mLXJhbmRvbQ", "expires_at": "2026-11-23T08:30:30.000Z"}
TRAJECTORY = {
    "id": SESSION_ID,
    "results": [{name: RESULT[name] for name in ("seq", "ts", "size", "region", "targets")}],
}
TRAJECTORY_TEXT = {
    "csv": "seq,ts,target,x,y,w,h,status,reliable,scale,confidence\n"
    "17,1712.5,0,201.4,213.2,34.7,82.6,tracking,true,1.02,0.93\n",
    "otb": "202.4,214.2,34.7,82.6\n",
    "mot": "18,1,202.4,214.2,34.7,82.6,0.93,-1,-1,-1\n",
}
CREATE = {"frame": "/9j/4AAQSkZJRg==", "box": BOX, "options": {"preset": "default", "label": "court 3"}}
METRICS = "# TYPE mfcmt_sessions_active gauge\nmfcmt_sessions_active 3.0\n"
HEALTH = {"status": "ok", "lanes_ready": 2, "lanes": 2}

CAPABILITIES = {
    "protocol": VERSION,
    "subprotocols": list(CODECS),
    "modes": [mode.value for mode in Mode],
    "presets": [preset.value for preset in Preset],
    "image_types": list(IMAGE_TYPES),
    "trajectory_formats": [one.value for one in TrajectoryFormat],
    "snapshot_versions": [1, 2],
    "limits": {
        "max_frame_bytes": 8388608,
        "max_frame_pixels": 8300000,
        "max_frame_side_px": 8192,
        "max_frame_scans": 16,
        "max_frame_scan_pixels": 25_000_000,
        "max_json_frame_bytes": 262144,
        "max_body_bytes": 65536,
        "max_snapshot_bytes": 67108864,
        "max_targets_per_session": 16,
        "max_sessions_per_key": 32,
        "max_streams_per_key": 2048,
        "max_trajectory_bytes": 8388608,
        "idle_timeout_s": 300.0,
        "max_idle_timeout_s": 3600.0,
        "attached_idle_timeout_s": 600.0,
        "max_session_s": 86400.0,
        "operation_deadline_s": 5.0,
        "credit_frames": 4,
        "region_lag_frames": 1,
        "max_messages_per_s": 2000.0,
        "max_requests_per_s": 1000.0,
        "max_frames_per_s_per_key": 5000.0,
        "max_frame_bytes_per_s_per_key": 268435456.0,
        "ticket_s": 30.0,
        "max_ticket_s": 300.0,
    },
    "software": {"mfcmt": "0.1.0", "numpy": "2.4.6", "opencv": "5.0.0", "numba": "0.68.1"},
}

READY = {
    "type": "ready",
    "session": SESSION | {"stream": {"url": SESSION["stream"]["url"], "attached": True}},  # type: ignore[index]
    "mode": "lossless",
    "credit": 4,
    "region_lag": 1,
    "next_seq": 1,
    "attachment": "Zk3v0c8VYw1q",
    "lost_after": None,
}
TARGETS = {"type": "targets", "ref": "a1", "region": REGION, "targets": [STARTED]}
DRAINING = {"type": "draining", "reconnect_in_s": 3.2, "resumable": True}
META = {"type": "meta", "seq": 17, "ts": 1712.5, "region": REGION}
CONTROLS: list[dict[str, Any]] = [
    {"type": "add", "box": BOX, "ref": "a1"},
    {"type": "correct", "target": 0, "box": BOX, "on": "next"},
    {"type": "remove", "target": 1, "ref": 7},
]

_MEMBERS: dict[str, dict[str, Any]] = {
    "session-gone": {"reason": "idle"},
    "elsewhere": {"url": "http://127.0.0.1:8001/v1/sessions/node-1.Zk3v0c8VYw1q"},
    "bad-region": {"region": REGION},
    "full-frame-needed": {"region": [0, 0, 576, 432]},
    "over-credit": {"retry_after_s": 0.1},
    "rate-limited": {"retry_after_s": 0.5},
    "over-quota": {"retry_after_s": 1.0},
    "at-capacity": {"retry_after_s": 1.0},
    "draining": {"retry_after_s": 15.0},
    "internal": {"request_id": "9f86d081884c7d65"},
}


def problem(code: ProblemCode | str) -> dict[str, Any]:
    """Return an example of a problem's document."""
    code = ProblemCode(code)
    return ProblemError(code, CATALOGUE[code].example, **_MEMBERS.get(code, {})).body()


ERROR = {"type": "error", "seq": 18, "problem": problem("frame-undecodable")}

ANSWERS: dict[str, dict[str, Any]] = {
    "Session": SESSION,
    "SessionPage": PAGE,
    "Result": RESULT,
    "TargetAnswer": TARGET_ANSWER,
    "TicketAnswer": TICKET,
    "TrajectoryAnswer": TRAJECTORY,
    "Capabilities": CAPABILITIES,
    "Health": HEALTH,
}
BODIES: dict[str, dict[str, Any]] = {"BoxBody": {"box": BOX}, "TicketBody": {"ttl_s": 30}}

STREAM: dict[str, list[dict[str, Any]]] = {
    "Meta": [META],
    "FrameMessage": [{"type": "frame", "frame": "(bin)", "seq": 17}],
    "Add": [CONTROLS[0]],
    "Correct": [CONTROLS[1]],
    "Remove": [CONTROLS[2]],
    "Ready": [READY],
    "Result": [RESULT],
    "Error": [ERROR],
    "Targets": [TARGETS],
    "Draining": [DRAINING],
}
