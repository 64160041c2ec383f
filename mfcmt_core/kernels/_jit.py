"""One place that says how kernels are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile for this CPU on first call, without the GIL, and keep the result on disk.

    ``fastmath`` lets sums be vectorised; inputs are finite by construction.
    """
    try:
        return numba.njit(cache=True, fastmath=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # no writable place for the cache at all: compile in memory
        return numba.njit(fastmath=True, nogil=True, error_model="numpy")(function)
