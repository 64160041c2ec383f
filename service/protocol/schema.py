"""JSON Schemas of the messages, and reading of bodies and messages by Pydantic where speed does not matter."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import is_dataclass
from functools import cache
from typing import Any, TypeVar

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema

from . import answers, capabilities, requests
from .values import BOX_DOC, ECHO_DOC, REGION_DOC, SEQ_DOC, Box, Echo, Region, Seq

T = TypeVar("T")

# Names that schemas had before the classes got theirs; they are the names of classes in generated clients.
NAMES = {
    "SessionInfo": "Session",
    "StreamAddress": "Stream",
    "TargetChange": "TargetAnswer",
    "Ticket": "TicketAnswer",
    "Trajectory": "TrajectoryAnswer",
    "ProblemDocument": "Problem",
}
VALUES: dict[str, tuple[Any, dict[str, Any]]] = {
    "Box": (Box, BOX_DOC),
    "Region": (Region, REGION_DOC),
    "Seq": (Seq, SEQ_DOC),
    "Echo": (Echo, ECHO_DOC),
}
REF = "#/components/schemas/{model}"
_OPEN = (answers.ProblemDocument.__name__,)
# What the service sends has all of its fields, also those with a default for rows and clients of before.
_SENT: dict[str, Any] = {
    name: kind for name, kind in (vars(answers) | vars(capabilities)).items() if is_dataclass(kind)
}
_TAGGED = {kind.__name__: kind for kind in (*answers.STREAM_MESSAGES, *requests.STREAM_MESSAGES)}


def adapter(kind: type[T]) -> TypeAdapter[T]:
    """Return what reads plain values as ``kind``: ``adapter(SessionInfo).validate_python(answer)``."""
    return _adapter(kind)  # type: ignore[arg-type]


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def name_of(kind: type) -> str:
    """Return the name of a message's schema."""
    return NAMES.get(kind.__name__, kind.__name__)


def schemas(kinds: Iterable[type]) -> dict[str, Any]:
    """Return the schemas of ``kinds``, of all that they refer to, and of the values, by name."""
    generator = GenerateJsonSchema(ref_template="{model}")
    inputs: list[Any] = [(kind, "validation", adapter(kind).core_schema) for kind in kinds]
    found: dict[Any, Any] = generator.generate_definitions(inputs)[1]
    enums = {name: schema for name, schema in found.items() if "enum" in schema}
    made = {NAMES.get(name, name): _finished(name, found[name], enums) for name in found if name not in enums}
    made |= {name: doc | TypeAdapter(kind).json_schema() for name, (kind, doc) in VALUES.items()}
    return {name: _resolved(made[name]) for name in sorted(made)}


def _finished(name: str, schema: dict[str, Any], enums: Mapping[str, Any]) -> dict[str, Any]:
    """Return the schema of a class with its ``type``, closed sets in place, and no further fields."""
    properties: dict[str, Any] = schema["properties"]
    for field, value in properties.items():
        if (closed := enums.get(value.get("$ref"))) is not None:
            del value["$ref"]
            value |= {"enum": closed["enum"], "title": field.replace("_", " ").title(), "type": "string"}
    if (sent := _SENT.get(name)) is not None:
        optional = getattr(sent, "OPTIONAL", ())
        schema["required"] = [field for field in properties if field not in optional]
    if (kind := _TAGGED.get(name)) is not None:
        schema["properties"] = {"type": {"const": kind.TYPE, "title": "Type", "type": "string"}, **properties}
        schema["required"] = ["type", *schema.get("required", ())]
    first_paragraph = schema["description"].partition("\n\n")[0].replace("\n", " ")
    return schema | {
        "title": NAMES.get(name, name),
        "description": first_paragraph,
        "additionalProperties": name in _OPEN,
    }


def _resolved(schema: Any) -> Any:
    """Return ``schema`` with whole references, and without an integer beside a number."""
    if isinstance(schema, list):
        kinds = [one.get("type") for one in schema if isinstance(one, dict)]
        return [_resolved(one) for one in schema if one != {"type": "integer"} or "number" not in kinds]
    if not isinstance(schema, dict):
        return schema
    made = {key: _resolved(value) for key, value in schema.items()}
    if "$ref" in made:
        made["$ref"] = REF.format(model=NAMES.get(made["$ref"], made["$ref"]))
    return made
