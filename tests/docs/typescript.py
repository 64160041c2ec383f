"""The types of mfcmt.d.ts that are the protocol's; ``make guide`` writes them, ``make lint`` checks them."""

from __future__ import annotations

import re
import textwrap
import types
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from datetime import datetime
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from service.protocol import answers, capabilities, requests
from service.protocol.enums import IMAGE_TYPES, EndReason, Mode, Preset, ProblemCode, Resize, Status, TrajectoryFormat
from service.protocol.target import Flags, Scores, Target
from service.protocol.values import Box, Region, Size

DECLARATIONS = Path(__file__).resolve().parents[2] / "service/web/client/mfcmt.d.ts"
BLOCK = re.compile(r"(// Generated from service/protocol .*?\n)(.*?)(// End of the generated part\n)", re.S)
WIDTH = 120

# Names that the client's users know.
NAMES: dict[type, str] = {Status: "TargetStatus", answers.Targets: "TargetsMessage", requests.Options: "SessionOptions"}
# Optional fields that may also be there as null; others are left out.
MAY_BE_NULL = ("maps", "region")
ENUMS: tuple[type[Enum], ...] = (Mode, Status, Preset, Resize, TrajectoryFormat, EndReason, ProblemCode)
INTERFACES = (
    Flags,
    Scores,
    Target,
    answers.Timing,
    answers.Result,
    answers.PastResult,
    answers.StreamAddress,
    answers.SessionInfo,
    answers.Ready,
    answers.Targets,
    answers.TargetChange,
    answers.Ticket,
    capabilities.Limits,
    capabilities.Capabilities,
    answers.ProblemDocument,
    requests.Options,
)
PLAIN: dict[Any, str] = {
    type(None): "null",
    int: "number",
    float: "number",
    str: "string",
    bool: "boolean",
    bytes: "Bytes",
    datetime: "string",
    Box: "Box",
    Region: "Region",
    Size: "Size",
}


def generated() -> str:
    """Return the block of the protocol's types."""
    return "\n".join(["", *_parts()])


def _parts() -> Iterator[str]:
    for enum in ENUMS:
        yield from _comment(_first_paragraph(enum))
        yield from _alias(_name(enum), [one.value for one in enum])
    yield from _alias("ImageType", IMAGE_TYPES)
    yield ""
    for kind in INTERFACES:
        yield from _comment(_first_paragraph(kind))
        yield f"export interface {_name(kind)} {{"
        if tag := getattr(kind, "TYPE", None):
            yield f'  type: "{tag}";'
        hints = get_type_hints(kind, include_extras=True)
        for one in fields(kind):
            yield from _field(kind, one, hints[one.name])
        if kind is answers.ProblemDocument:
            yield "  [member: string]: unknown;"
        yield "}"
        yield ""


def _comment(text: str, indent: str = "") -> Iterator[str]:
    line = f"{indent}/** {text} */"
    if len(line) <= WIDTH:
        yield line
        return
    yield f"{indent}/**"
    yield from textwrap.wrap(text, WIDTH, initial_indent=f"{indent} * ", subsequent_indent=f"{indent} * ")
    yield f"{indent} */"


def _alias(name: str, values: Any) -> Iterator[str]:
    line = f"export type {name} ="
    for value in values:
        more = f' "{value}"' if line.endswith("=") else f' | "{value}"'
        if len(line) + len(more) >= WIDTH:
            yield line
            line = " "
        line += more
    yield f"{line};"


def _field(kind: type, one: Field[Any], hint: Any) -> Iterator[str]:
    if text := one.metadata.get("description"):
        yield from _comment(f"{text[0].upper()}{text[1:]}.", "  ")
    chosen = kind is requests.Options and one.default is not MISSING
    optional = chosen or one.name in getattr(kind, "OPTIONAL", ())
    written = _type(hint)
    if optional and one.name not in MAY_BE_NULL:
        written = written.removesuffix(" | null")
    yield f"  {one.name}{'?' if optional else ''}: {written};"


def _type(hint: Any) -> str:
    """Return a type of the protocol as TypeScript writes it."""
    if hint in PLAIN:
        return PLAIN[hint]
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _type(args[0])
    if origin in (Union, types.UnionType):
        return " | ".join(dict.fromkeys(map(_type, args)))
    if origin is tuple and args[1:] == (...,):
        return f"{_type(args[0])}[]"
    if origin is Mapping:
        return f"Record<string, {_type(args[1])}>"
    if is_dataclass(hint) or (isinstance(hint, type) and issubclass(hint, Enum)):
        return _name(hint)
    raise TypeError(f"no TypeScript for {hint}")


def _name(kind: Any) -> str:
    return NAMES.get(kind, kind.__name__)


def _first_paragraph(kind: type) -> str:
    return (kind.__doc__ or "").partition("\n\n")[0].replace("\n    ", " ")


def fresh(text: str) -> str:
    """Return the text of the declarations with the generated part as it should be."""
    return BLOCK.sub(lambda found: found[1] + generated() + found[3], text)
