"""What the front tells its lanes when they start."""

from __future__ import annotations

from typing import Any

from ..settings import Settings


def lane_config(settings: Settings) -> dict[str, Any]:
    """Plain values for ``service.lanes.operations.LaneOperations``; no secret is among them."""
    return {
        "frame_limits": {
            "max_bytes": settings.max_frame_bytes,
            "max_pixels": settings.max_frame_pixels,
            "max_side": settings.max_frame_side_px,
            "max_scans": settings.max_frame_scans,
            "max_scan_pixels": settings.max_frame_scan_pixels,
        },
        "max_targets": settings.max_targets_per_session,
        "region_lag": settings.region_lag_frames,
    }
