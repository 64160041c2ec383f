"""The Python client against a real server, and what that server logs."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, contextmanager
from typing import Any

import pytest

from service.client import AsyncClient
from service.load.own import OwnServer
from tests.service.wire.conftest import Stream, Wire

Serve = Callable[..., OwnServer]
MSGPACK, JSON = "mfcmt.v1.msgpack", "mfcmt.v1.json"


@pytest.fixture
async def client(server: OwnServer) -> AsyncIterator[AsyncClient]:
    async with AsyncClient(server.url, timeout_s=10) as opened:
        yield opened


def attach(
    server: OwnServer, session_id: str, protocol: str = MSGPACK, **query: str
) -> AbstractAsyncContextManager[Stream]:
    """A bare stream, for what a well-behaved client would never send."""
    return Wire(server).stream(session_id, protocols=[protocol], **{"mode": "lossless"} | query)


class Log:
    """What a server logs from now on."""

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
def watch(server: OwnServer) -> Iterator[Log]:
    """No traceback and no error may be logged inside."""
    log = Log(server)
    yield log
    assert "Traceback" not in log.text
    assert not log.lines(level="error")
