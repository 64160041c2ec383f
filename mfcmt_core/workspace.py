"""Scratch arrays that the trackers of one thread share, so that a tracker owns only its models."""

from __future__ import annotations

import threading
from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

_local = threading.local()


def scratch(name: str, shape: tuple[int, ...], dtype: npt.DTypeLike = np.float32) -> npt.NDArray[Any]:
    """An array of that shape in the memory of that name; its contents are whatever the last user left there.

    One buffer a name grows to the largest shape asked for, so that a process that has seen targets and frames
    of a thousand shapes holds no more than one that saw the largest. A name has one dtype.
    """
    buffers: dict[str, npt.NDArray[Any]] = _local.__dict__.setdefault("buffers", {})
    size = prod(shape)
    buffer = buffers.get(name)
    if buffer is None or buffer.size < size:
        buffer = buffers[name] = np.zeros(size, dtype)
    return buffer[:size].reshape(shape)
