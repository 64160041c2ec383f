"""Rows of a lane to the maps of the protocol; by hand, because it happens on every frame."""

from __future__ import annotations

from typing import Any

_CUES = ("fused", "template", "statistical")


def target(row: list[Any]) -> dict[str, Any]:
    """A Target of the protocol from ``[id, box, status, reliable, flags, scores, psr, updated, scale]``."""
    tid, box, status, reliable, flags, scores, psr, updated, scale = row
    return {
        "id": tid,
        "box": box,
        "status": status,
        "reliable": reliable,
        "flags": flags and dict(zip(_CUES, flags, strict=True)),
        "scores": scores and dict(zip(_CUES, scores, strict=True)),
        "psr": psr,
        "updated": updated,
        "scale": scale,
    }


def targets(rows: list[list[Any]], maps: list[dict[str, bytes]] | None = None) -> list[dict[str, Any]]:
    """All targets of a frame; with ``maps``, each with its response maps."""
    told = [target(row) for row in rows]
    for one, images in zip(told, maps or (), strict=False):
        one["maps"] = images
    return told
