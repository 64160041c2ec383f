"""The fixtures of the service's tests: real frames, a real server."""

from tests.service.conftest import clip, own_server, server
from tests.service.jsclient.conftest import files, node

__all__ = ["clip", "files", "node", "own_server", "server"]
