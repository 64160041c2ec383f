"""Limits that the front gives its lanes when they start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mfcmt_core.images import FrameLimits

if TYPE_CHECKING:
    from ..settings import Settings


@dataclass(frozen=True, slots=True)
class LaneLimits:
    """The limits of every session in a lane; no secret is among them.

    ``region_lag`` is the number of frames in flight that regions leave room for.
    """

    frame: FrameLimits
    max_targets: int
    region_lag: int

    @classmethod
    def of(cls, settings: Settings) -> LaneLimits:
        """Return the limits that the settings name."""
        frame = FrameLimits(
            max_bytes=settings.max_frame_bytes,
            max_pixels=settings.max_frame_pixels,
            max_side=settings.max_frame_side_px,
            max_scans=settings.max_frame_scans,
            max_scan_pixels=settings.max_frame_scan_pixels,
        )
        return cls(frame, settings.max_targets_per_session, settings.region_lag_frames)
