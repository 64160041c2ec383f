"""Where frames come from."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable, AsyncIterator, Iterable
from itertools import islice
from typing import TypeVar

T = TypeVar("T")


async def each(frames: AsyncIterable[T] | Iterable[T]) -> AsyncIterator[T]:
    """The frames one by one; a lazy sync source is read in a thread, since it may wait for a camera."""
    if isinstance(frames, AsyncIterable):
        async for frame in frames:
            yield frame
    elif isinstance(frames, list | tuple):
        for frame in frames:
            yield frame
    else:
        source = iter(frames)
        while batch := await asyncio.to_thread(lambda: list(islice(source, 1))):
            yield batch[0]
