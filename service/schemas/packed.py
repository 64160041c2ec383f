"""JSON and MessagePack, under the name that this module had; see ``service.protocol.documents``."""

from __future__ import annotations

from ..protocol.documents import (
    MAX_ITEMS_IN_ALL,
    MAX_TEXT_BYTES,
    Unreadable,
    from_json,
    from_msgpack,
    to_json,
    to_msgpack,
)

__all__ = ["MAX_ITEMS_IN_ALL", "MAX_TEXT_BYTES", "Unreadable", "from_json", "from_msgpack", "to_json", "to_msgpack"]
