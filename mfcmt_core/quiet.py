"""Silence libraries that print on the standard error by themselves."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from functools import cache


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Discard everything that this process prints on the standard error within the block."""
    try:
        kept = os.dup(2)
    except OSError:  # it is closed: nothing can be printed
        yield
        return
    os.dup2(_nowhere(), 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


@cache
def _nowhere() -> int:
    """Return the null device, opened once: a confined lane may not open files later."""
    return os.open(os.devnull, os.O_WRONLY)
