"""The Python client: sessions over HTTP, frames over WebSocket; needs neither numpy nor OpenCV.

>>> from service.client import Client
>>> with Client() as client, client.create(first_jpeg, box=(220, 140, 60, 80)) as session:
...     for result in session.stream(jpegs):
...         print(result.seq, result.target.box, result.target.status)
"""

from .aio import AsyncClient
from .errors import ClientError, ConnectionLost, Problem
from .session import AsyncSession
from .stream import AsyncStream
from .sync import Client, Session, Stream
from .types import (
    Box,
    Draining,
    Flags,
    Frame,
    Image,
    Mode,
    Ready,
    Region,
    Result,
    Resumed,
    Scores,
    SessionInfo,
    Size,
    Status,
    Target,
    TargetChange,
    Targets,
    Ticket,
    Timing,
)

__all__ = [
    "AsyncClient",
    "AsyncSession",
    "AsyncStream",
    "Box",
    "Client",
    "ClientError",
    "ConnectionLost",
    "Draining",
    "Flags",
    "Frame",
    "Image",
    "Mode",
    "Problem",
    "Ready",
    "Region",
    "Result",
    "Resumed",
    "Scores",
    "Session",
    "SessionInfo",
    "Size",
    "Status",
    "Stream",
    "Target",
    "TargetChange",
    "Targets",
    "Ticket",
    "Timing",
]
