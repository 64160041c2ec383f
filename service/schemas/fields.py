"""Values of the protocol, read by hand: what is wrong gets a code of the catalogue."""

from __future__ import annotations

import math
from typing import Any

from ..problems import ProblemError

MAX_SEQ = 2**53 - 1
MAX_ECHO = 64
KINDS: dict[type, str] = {dict: "a map", list: "lists", bool: "true or false", type(None): "null", bytes: "bytes"}


def box(value: Any) -> list[float]:
    """``[x, y, w, h]``, four finite numbers, ``w, h > 0``. Raises bad-request, bad-box."""
    if type(value) is not list or len(value) != 4 or any(type(v) not in (int, float) for v in value):
        raise ProblemError("bad-request", f"a box is four numbers, [x, y, w, h]{_instead(value)}")
    try:
        x, y, w, h = map(float, value)
    except OverflowError:
        x = y = w = h = math.inf
    if not all(map(math.isfinite, (x, y, w, h))):
        raise ProblemError("bad-box", "the box is not finite")
    if not (w > 0 and h > 0):
        raise ProblemError("bad-box", "the box has no area: w and h are above 0; a box is x, y, w, h")
    return [x, y, w, h]


def _instead(value: Any) -> str:
    """What was given where four numbers are wanted, without repeating it."""
    if value is None:
        return "; none is given"
    if type(value) is str:
        return ", not a text with them: leave out the quotes"
    if type(value) is not list:
        return f", not {KINDS.get(type(value), 'this')}"
    if len(value) != 4:
        return f", not {len(value)}"
    odd = next(v for v in value if type(v) not in (int, float))
    return ", not texts: leave out the quotes" if type(odd) is str else f", not {KINDS.get(type(odd), 'these')}"


def region(value: Any) -> list[int] | None:
    """``[x, y, w, h]`` in whole pixels, or None. Raises bad-request, bad-region."""
    if value is None:
        return None
    if type(value) is not list or len(value) != 4 or any(type(v) is not int for v in value):
        raise ProblemError("bad-request", "a region is four whole numbers: [x, y, w, h]")
    if any(abs(v) > 1 << 20 for v in value) or value[2] <= 0 or value[3] <= 0:
        raise ProblemError("bad-region", "the region leaves the frame", region=None)
    return value


def seq(value: Any) -> int | None:
    """A frame's number, or None. Raises bad-request."""
    if value is None:
        return None
    if type(value) is not int or not 0 <= value <= MAX_SEQ:
        raise ProblemError("bad-request", "seq is a whole number from 0 to 2^53 - 1")
    return value


def echo(name: str, value: Any) -> float | str | None:
    """What is echoed and never interpreted: a finite number or a short string. Raises bad-request."""
    if value is None:
        return None
    if type(value) is int and abs(value) <= MAX_SEQ:
        return value
    if type(value) is float and math.isfinite(value):
        return value
    if type(value) is str and len(value) <= MAX_ECHO:
        return value
    raise ProblemError("bad-request", f"{name} is a number or a string of at most {MAX_ECHO} characters")


def target(value: Any) -> int:
    """A target's id. Raises bad-request."""
    if type(value) is not int or not 0 <= value <= MAX_SEQ:
        raise ProblemError("bad-request", "target is a target's id")
    return value
