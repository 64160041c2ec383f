"""Values that messages are made of: their types, their bounds, and the checks of those that clients send."""

from __future__ import annotations

import math
from typing import Annotated, Any

from annotated_types import Ge, Gt, Le, MaxLen

from .enums import ProblemCode
from .problems import ProblemError

MAX_SEQ = 2**53 - 1
MAX_ECHO_CHARACTERS = 64
MAX_SIDE_PX = 1 << 20

Side = Annotated[float, Gt(0)]
Whole = Annotated[int, Ge(0), Le(MAX_SIDE_PX)]
Positive = Annotated[int, Gt(0), Le(MAX_SIDE_PX)]

Box = tuple[float, float, Side, Side]
"""``(x, y, w, h)``: pixels of the whole decoded frame, 0-based, top-left corner."""

Region = tuple[Whole, Whole, Positive, Positive]
"""``(x, y, w, h)`` in whole pixels of the frame."""

Size = tuple[Positive, Positive]
"""``(w, h)`` in pixels."""

Seq = Annotated[int, Ge(0), Le(MAX_SEQ)]
"""The number of a frame message in its session."""

Echo = int | float | Annotated[str, MaxLen(MAX_ECHO_CHARACTERS)]
"""A value that is sent back and never interpreted."""

# What JSON Schemas say of these values beside their bounds.
BOX_DOC = {
    "description": "`[x, y, w, h]`: pixels of the whole frame after EXIF orientation, 0-based, top-left corner",
    "examples": [[198, 214, 34, 81]],
}
REGION_DOC = {"description": "`[x, y, w, h]` in whole pixels of the frame", "examples": [[120, 100, 190, 240]]}
SEQ_DOC = {"description": "number of a frame message", "examples": [17]}
ECHO_DOC = {"description": "echoed, never interpreted", "examples": [1712.5]}
REF_DOC = {"description": "echoed in the answer", "examples": ["a1"]}

_KINDS: dict[type, str] = {dict: "a map", list: "lists", bool: "true or false", type(None): "null", bytes: "bytes"}


def check_box(value: Any) -> list[float]:
    """Return ``[x, y, w, h]`` as finite floats with ``w, h > 0``. Raises bad-request, bad-box."""
    if type(value) is not list or len(value) != 4 or any(type(v) not in (int, float) for v in value):
        raise ProblemError(ProblemCode.BAD_REQUEST, f"a box is four numbers, [x, y, w, h]{_instead_of_box(value)}")
    try:
        x, y, w, h = map(float, value)
    except OverflowError:
        x = y = w = h = math.inf
    if not all(map(math.isfinite, (x, y, w, h))):
        raise ProblemError(ProblemCode.BAD_BOX, "the box is not finite")
    if not (w > 0 and h > 0):
        raise ProblemError(ProblemCode.BAD_BOX, "the box has no area: w and h are above 0; a box is x, y, w, h")
    return [x, y, w, h]


def _instead_of_box(value: Any) -> str:
    """Say what came in place of four numbers, without repeating the value."""
    if value is None:
        return "; none is given"
    if type(value) is str:
        return ", not a text with them: leave out the quotes"
    if type(value) is not list:
        return f", not {_KINDS.get(type(value), 'this')}"
    if len(value) != 4:
        return f", not {len(value)}"
    odd = next(v for v in value if type(v) not in (int, float))
    return ", not texts: leave out the quotes" if type(odd) is str else f", not {_KINDS.get(type(odd), 'these')}"


def check_region(value: Any) -> list[int] | None:
    """Return ``[x, y, w, h]`` in whole pixels, or None. Raises bad-request, bad-region."""
    if value is None:
        return None
    if type(value) is not list or len(value) != 4 or any(type(v) is not int for v in value):
        raise ProblemError(ProblemCode.BAD_REQUEST, "a region is four whole numbers: [x, y, w, h]")
    if any(abs(v) > MAX_SIDE_PX for v in value) or value[2] <= 0 or value[3] <= 0:
        raise ProblemError(ProblemCode.BAD_REGION, "the region leaves the frame", region=None)
    return value


def check_seq(value: Any) -> int | None:
    """Return a frame's number, or None. Raises bad-request."""
    if value is None:
        return None
    if type(value) is not int or not 0 <= value <= MAX_SEQ:
        raise ProblemError(ProblemCode.BAD_REQUEST, "seq is a whole number from 0 to 2^53 - 1")
    return value


def check_echo(name: str, value: Any) -> float | str | None:
    """Return a finite number or a short string, to be echoed; or None. Raises bad-request."""
    if value is None:
        return None
    if type(value) is int and abs(value) <= MAX_SEQ:
        return value
    if type(value) is float and math.isfinite(value):
        return value
    if type(value) is str and len(value) <= MAX_ECHO_CHARACTERS:
        return value
    detail = f"{name} is a number or a string of at most {MAX_ECHO_CHARACTERS} characters"
    raise ProblemError(ProblemCode.BAD_REQUEST, detail)


def check_target(value: Any) -> int:
    """Return a target's id. Raises bad-request."""
    if type(value) is not int or not 0 <= value <= MAX_SEQ:
        raise ProblemError(ProblemCode.BAD_REQUEST, "target is a target's id")
    return value
