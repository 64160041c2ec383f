"""Scratch arrays that the trackers of one thread share, so that a tracker owns only its models."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import numpy.typing as npt

_local = threading.local()


def scratch(name: str, shape: tuple[int, ...], dtype: npt.DTypeLike = np.float32) -> npt.NDArray[Any]:
    """The array of that name and shape; its contents are whatever the last user left there."""
    arrays: dict[tuple[str, tuple[int, ...]], npt.NDArray[Any]] = _local.__dict__.setdefault("arrays", {})
    array = arrays.get((name, shape))
    if array is None:
        array = arrays[name, shape] = np.zeros(shape, dtype)
    return array
