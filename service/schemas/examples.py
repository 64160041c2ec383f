"""Examples of the protocol, under the name that this module had; see ``service.protocol.examples``."""

from ..protocol.examples import *  # noqa: F403
