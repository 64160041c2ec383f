"""A target in one frame: as an object, as the map of a message, and as the row that lanes send and stores keep.

A row is the list of the fields' values, in the order of the definition and without ``maps``. A field that is added
goes after the last one of the row and has a default: rows that were kept before are read with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, ClassVar

from .enums import Status
from .values import BOX_DOC, Box

Row = list[Any]


def _in_json(schema: dict[str, Any]) -> None:
    """Describe images as they are in JSON, base64 and not bytes."""
    schema["anyOf"][0]["additionalProperties"] = {"type": "string"}


@dataclass(frozen=True, slots=True)
class Flags:
    """The three tests of section III-C."""

    fused: bool
    template: bool
    statistical: bool


@dataclass(frozen=True, slots=True)
class Scores:
    """Each peak over its mean of the last 10 frames."""

    fused: float
    template: float
    statistical: float


@dataclass(frozen=True, slots=True)
class Target:
    """Where a target is and how far to trust it.

    ``reliable``, ``flags``, ``scores`` and ``psr`` are None on the frame that started or corrected the target.
    """

    OPTIONAL: ClassVar = ("maps",)

    id: int = field(metadata={"ge": 0, "description": "unique in the session; the first is 0"})
    box: Box = field(metadata={**BOX_DOC, "description": f"{BOX_DOC['description']}; the last known one while lost"})
    status: Status = field(
        metadata={
            "description": "`tracking`, `uncertain` or `lost` (not found for long enough; the search goes on): by the"
            " confidence, with the preset `paper` by the three tests"
        }
    )
    reliable: bool | None = field(
        metadata={
            "description": "all three flags, and the status is `tracking`; null on the frame that started or corrected"
            " the target, as are `flags`, `scores` and `psr`"
        }
    )
    flags: Flags | None = field(
        metadata={"description": "`{fused, template, statistical}`: the three tests of section III-C"}
    )
    scores: Scores | None = field(
        metadata={"description": "`{fused, template, statistical}`: each peak over its mean of the last 10 frames"}
    )
    psr: float | None = field(
        metadata={"description": "peak-to-sidelobe ratio of the fused map, without 11×11 around the peak"}
    )
    updated: bool = field(metadata={"description": "whether the models learned from this frame"})
    scale: float = field(metadata={"gt": 0, "description": "size relative to the box given"})
    # What is added goes here, with a default.
    confidence: float | None = field(
        default=None,
        metadata={
            "ge": 0,
            "le": 1,
            "description": "probability that the box overlaps the target by more than half: the number to act on; null"
            " only in results that an older version kept",
        },
    )
    maps: Mapping[str, bytes] | None = field(
        default=None,
        metadata={
            "description": "response maps as gray PNG, base64 in JSON, where `maps` was asked for",
            "json_schema_extra": _in_json,
        },
    )


ROW_FIELDS = tuple(one.name for one in fields(Target) if one.name != "maps")
"""The names of a row's values."""
_DEFAULTS = tuple(None if one.default is MISSING else one.default for one in fields(Target) if one.name != "maps")
_PARTS = {name: tuple(part.name for part in fields(kind)) for name, kind in (("flags", Flags), ("scores", Scores))}


def complete(row: Sequence[Any]) -> Row:
    """Return ``row`` with the defaults of the fields that were added after it was written."""
    return [*row, *_DEFAULTS[len(row) :]]


def row_to_map(row: Row, maps: Mapping[str, bytes] | None = None) -> dict[str, Any]:
    """Return the Target of a message. This happens for every target of every frame."""
    if len(row) < len(ROW_FIELDS):
        row = complete(row)
    target = dict(zip(ROW_FIELDS, row, strict=False))
    for name, parts in _PARTS.items():
        if values := target[name]:
            target[name] = dict(zip(parts, values, strict=True))
    if maps is not None:
        target["maps"] = maps
    return target


def rows_to_maps(rows: Sequence[Row], maps: Sequence[Mapping[str, bytes]] | None = None) -> list[dict[str, Any]]:
    """Return the Targets of a message, each with its response maps where there are any."""
    if maps is None:
        return [row_to_map(row) for row in rows]
    return [row_to_map(row, images) for row, images in zip(rows, maps, strict=True)]
