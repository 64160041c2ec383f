"""Real frames and real servers, for all tests of the service."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from service.load.clips import Clip, open_clip, sample
from service.load.own import OwnServer
from tests.conftest import OTB_ROOT


@pytest.fixture(scope="session")
def clip() -> Clip:
    """The first frames of a real sequence where there is one, else of the rendered clip."""
    david = OTB_ROOT / "David"
    return open_clip(david, None, 60) if david.is_dir() else sample(60)


# Ample: on a busy machine a lane may get no processor for seconds, and would be replaced as one that hangs.
DEADLINE = {"operation_deadline_s": 60}


@pytest.fixture(scope="session")
def server() -> Iterator[OwnServer]:
    """Two lanes with the default limits but for the deadline; shared by all tests that need nothing else."""
    with OwnServer(lanes=2, max_sessions_per_lane=64, log_level="debug", **DEADLINE) as own:
        yield own


@pytest.fixture
def own_server() -> Iterator[Callable[..., OwnServer]]:
    """Servers with settings of their own, ended with the test."""
    with ExitStack() as stack:

        def start(**settings: object) -> OwnServer:
            return stack.enter_context(OwnServer(**{"lanes": 1} | DEADLINE | settings))

        yield start
