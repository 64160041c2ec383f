"""What a call costs: ``python -m tests.service.unit.cost``.

Processor time of a GET of a session, without sockets and lanes: as it is, and with its dependencies in FastAPI's thread
pool, where plain functions run. In turns, so that the ratio holds on a busy machine.
"""

from __future__ import annotations

import asyncio
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from fastapi import FastAPI

from service.app import create_app
from service.observability import logs
from service.protocol.requests import Options
from service.settings import Settings

from .routes import dependencies, routes
from .test_registry import Lanes

ROUNDS, CALLS = 20, 300


@contextmanager
def in_threads(app: FastAPI) -> Iterator[None]:
    """Make every dependency a plain function meanwhile."""
    every = [(one, one.call) for route in routes(app) for one in dependencies(route.dependant)]
    for one, call in every:
        one.call = _plain(call)
    try:
        yield
    finally:
        for one, call in every:
            one.call = call


async def get_ms(app: FastAPI, path: str, calls: int) -> float:
    """Milliseconds of processor time of all threads for one GET."""
    begun = time.process_time()
    for _ in range(calls):
        statuses: list[int] = []
        await app(_scope(path), _nothing, _noting(statuses))
        assert statuses == [200]
    return (time.process_time() - begun) / calls * 1e3


async def measure() -> tuple[float, float]:
    """The median GET as it is, and with its dependencies in threads."""
    app = create_app(Settings(max_requests_per_s=1e8), lanes=Lanes(1))
    options = Options(idle_timeout_s=300.0)
    session = await app.state.service.registry.create("anyone", b"frame", [[1, 2, 3, 4]], options, None)
    path = f"/v1/sessions/{session.id}"
    shipped, threaded = [], []
    for _ in range(ROUNDS):
        shipped.append(await get_ms(app, path, CALLS))
        with in_threads(app):
            threaded.append(await get_ms(app, path, CALLS))
    return statistics.median(shipped), statistics.median(threaded)


def main() -> None:
    """Print them."""
    logs.configure("json", "error")
    shipped, threaded = asyncio.run(measure())
    print(f"GET of a session, as it is                     {shipped:.3f} ms")
    print(f"the same with its dependencies in threads      {threaded:.3f} ms")
    print(f"ratio                                          {shipped / threaded:.2f}")


def _plain(call: Any) -> Callable[..., Any]:
    def plain(**values: Any) -> Any:
        try:
            call(**values).send(None)
        except StopIteration as done:
            return done.value
        raise AssertionError("a dependency waits")

    return plain


def _scope(path: str) -> dict[str, Any]:
    headers = [(b"host", b"localhost:8000"), (b"accept", b"application/json")]
    return {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": "GET",
        "scheme": "http",
        "path": path,
        "raw_path": path.encode(),
        "root_path": "",
        "query_string": b"",
        "headers": headers,
        "client": ("127.0.0.1", 50_000),
        "server": ("127.0.0.1", 8000),
    }


async def _nothing() -> dict[str, Any]:
    return {"type": "http.request", "body": b"", "more_body": False}


def _noting(statuses: list[int]) -> Callable[[Any], Any]:
    async def note(message: dict[str, Any]) -> None:
        if message["type"] == "http.response.start":
            statuses.append(message["status"])

    return note


if __name__ == "__main__":
    main()
