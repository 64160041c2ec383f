"""A real Redis, and nodes that share it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.service.cluster.redis_server import RedisServer
from tests.service.jsclient.conftest import files, node, scenario

__all__ = ["files", "node", "scenario"]


@pytest.fixture(scope="module")
def redis_server() -> Iterator[RedisServer]:
    with RedisServer() as server:
        yield server
