"""Parse boxes as people write them after ``--box``."""

from __future__ import annotations

import re
from math import isfinite
from typing import TYPE_CHECKING

from . import UsageError

if TYPE_CHECKING:
    from ..result import Box

NUMBERS = re.compile(r"[-+\d.,\s]*\d[-+\d.,\s]*")


def join_box(argv: list[str]) -> list[str]:
    """Return ``argv`` with the numbers after each ``--box`` joined to one word.

    This allows ``--box 129 80 64 78``, and ``--box -5,80,64,78``, which argparse would take for an option.

    Examples
    --------
    >>> join_box(["--box", "-5", "80", "64", "78", "clip.mp4"])
    ['--box=-5,80,64,78', 'clip.mp4']
    """
    words: list[str] = []
    rest = list(argv)
    while rest:
        word = rest.pop(0)
        if word == "--box" and rest and NUMBERS.fullmatch(rest[0]):
            numbers: list[str] = []
            while rest and len(numbers) < 4 and NUMBERS.fullmatch(rest[0]):
                numbers += [part for part in re.split(r"[,\s]+", rest.pop(0)) if part]
            word = f"--box={','.join(numbers)}"
        words.append(word)
    return words


def parse_box(text: str) -> Box:
    """Return ``x,y,w,h`` as four numbers. Raises UsageError."""
    try:
        x, y, w, h = (float(v) for v in text.split(","))
    except ValueError:
        raise UsageError(f"--box takes four numbers x,y,w,h, as 129,80,64,78, not {text!r}") from None
    if not all(map(isfinite, (x, y, w, h))) or w <= 0 or h <= 0:
        raise UsageError(f"--box has no area: {text}; it is x,y,w,h in pixels")
    return x, y, w, h
