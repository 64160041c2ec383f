"""A real server in a process of its own, real frames, and its log."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest

from service.client import AsyncClient
from service.load.clips import Clip, open_clip, sample
from service.load.own import OwnServer
from tests.conftest import OTB_ROOT

Serve = Callable[..., OwnServer]


@pytest.fixture(scope="session")
def clip() -> Clip:
    """The first frames of a real sequence where there is one, else of the rendered clip."""
    david = OTB_ROOT / "David"
    return open_clip(david, None, 60) if david.is_dir() else sample(60)


@pytest.fixture(scope="session")
def server() -> Iterator[OwnServer]:
    """Two lanes with the default limits; shared, so no test may leave a session behind that others notice."""
    with OwnServer(lanes=2, max_sessions_per_lane=32, log_level="debug") as own:
        yield own


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Servers with other settings, ended with the test."""
    with ExitStack() as stack:

        def start(**settings: object) -> OwnServer:
            return stack.enter_context(OwnServer(**{"lanes": 1, "drain_grace_s": 0.2} | settings))

        yield start


@pytest.fixture
async def client(server: OwnServer) -> Any:
    async with AsyncClient(server.url, timeout_s=10) as opened:
        yield opened


class Log:
    """What a server logs within a ``with watch(server)`` block."""

    def __init__(self, server: OwnServer) -> None:
        self._server = server
        self._start = len(server.log)

    @property
    def text(self) -> str:
        return self._server.log[self._start :]

    def lines(self, **wanted: object) -> list[dict[str, Any]]:
        """The records that have all these values."""
        records = [json.loads(line) for line in self.text.splitlines()]
        return [r for r in records if all(r.get(name) == value for name, value in wanted.items())]


@contextmanager
def watch(server: OwnServer, errors: int = 0) -> Iterator[Log]:
    """No traceback may be logged inside, and just so many errors."""
    log = Log(server)
    yield log
    assert "Traceback" not in log.text
    assert len([record for record in log.lines() if record["level"] in ("error", "critical")]) == errors
