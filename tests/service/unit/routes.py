"""Every route of the application, and every dependency of each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from fastapi import FastAPI
from fastapi.dependencies.models import Dependant


def routes(app: FastAPI) -> list[Any]:
    """The calls of the application, each with its ``path``, ``endpoint`` and ``dependant``."""
    return [call for call in _flat(app.routes) if getattr(call, "dependant", None) is not None]


def dependencies(dependant: Dependant) -> Iterator[Dependant]:
    """What a call depends on, directly or not."""
    for one in dependant.dependencies:
        yield one
        yield from dependencies(one)


def _flat(some: Iterable[Any]) -> Iterator[Any]:
    """Routes without the routers around them, which FastAPI keeps as they were included."""
    for one in some:
        if hasattr(one, "effective_candidates"):
            yield from _flat(one.effective_candidates())
        else:
            yield one
