"""Libraries that print on the standard error by themselves, silenced."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from functools import cache


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Until the end of the block, what anything in this process prints on the standard error goes nowhere."""
    try:
        kept = os.dup(2)
    except OSError:  # closed: nothing can be printed
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
    """Opened once: a lane that is confined may open nothing any more."""
    return os.open(os.devnull, os.O_WRONLY)
