"""One attachment of a session over one WebSocket, as it is: no waiting for credit, no reconnecting."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Literal, cast

import msgpack
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException
from websockets.typing import Subprotocol

from .address import Address
from .errors import ConnectionLost, Problem, of_close
from .types import Draining, Frame, Mode, Ready, Result, Targets

Protocol = Literal["mfcmt.v1.msgpack", "mfcmt.v1.json"]
Message = Ready | Result | Targets | Draining | Problem

MAX_MESSAGE_BYTES = 64 * 1024 * 1024


class Connection:
    """An open attachment; made by :meth:`open`."""

    def __init__(self, socket: ClientConnection, binary: bool) -> None:
        self._socket = socket
        self._binary = binary

    @classmethod
    async def open(
        cls,
        address: Address,
        session_id: str,
        *,
        mode: Mode = "latest",
        protocol: Protocol = "mfcmt.v1.msgpack",
        ticket: str | None = None,
        takeover: bool = False,
        resume: str | None = None,
    ) -> Connection:
        """Attach to a session; the first message is ``ready``.

        ``takeover`` ends another attachment, ``resume`` only the one of that name. Raises
        :class:`Problem` when the server refuses, :class:`ConnectionLost` when it cannot be reached.
        """
        query: dict[str, str] = {"mode": mode}
        if takeover:
            query["takeover"] = "true"
        if resume is not None:
            query["resume"] = resume
        protocols: list[str] = [protocol] if ticket is None else [protocol, f"mfcmt.ticket.{ticket}"]
        try:
            socket = await connect(
                address.stream(session_id, query),
                subprotocols=cast(list[Subprotocol], protocols),
                additional_headers=address.headers,
                proxy=address.proxy_url,
                compression=None,
                max_size=MAX_MESSAGE_BYTES,
                open_timeout=address.timeout_s,
                close_timeout=address.timeout_s,
                ping_interval=address.ping_interval_s,
                ping_timeout=address.ping_interval_s,
            )
        except InvalidStatus as refused:
            raise problem_of(
                refused.response.status_code, bytes(refused.response.body or b""), address.way
            ) from refused
        except (OSError, TimeoutError, EOFError, WebSocketException) as failed:
            raise ConnectionLost(f"cannot attach: {address.failed(failed)}") from failed
        return cls(socket, binary=protocol == "mfcmt.v1.msgpack")

    async def send_frame(self, frame: Frame) -> None:
        """Send one frame. Raises what :meth:`receive` raises."""
        beside = {"seq": frame.seq, "ts": frame.ts, "region": frame.region}
        beside = {name: value for name, value in beside.items() if value is not None}
        if self._binary:
            await self._send(msgpack.packb({"type": "frame", "frame": frame.data, **beside}))
            return
        if beside:
            await self._send(json.dumps({"type": "meta", **beside}))
        await self._send(frame.data)

    async def send_control(self, control: Mapping[str, Any]) -> None:
        """Send ``add``, ``correct`` or ``remove``. Raises what :meth:`receive` raises."""
        await self._send(msgpack.packb(control) if self._binary else json.dumps(control))

    async def receive(self) -> Message:
        """The next message; a refused one is returned as a :class:`Problem`, not raised.

        Raises :class:`Problem` when the server has ended the attachment for good and
        :class:`ConnectionLost` when it may be resumed.
        """
        while True:
            try:
                data = await self._socket.recv()
            except ConnectionClosed as closed:
                raise _of_closed(closed) from closed
            message = _message(msgpack.unpackb(data) if isinstance(data, bytes) else json.loads(data))
            if message is not None:
                return message

    async def close(self) -> None:
        """End the attachment; the session lives on."""
        await self._socket.close()

    async def _send(self, data: bytes | str) -> None:
        try:
            await self._socket.send(data)
        except ConnectionClosed as closed:
            raise _of_closed(closed) from closed


def _message(wire: Any) -> Message | None:
    match wire["type"]:
        case "result":
            return Result.of(wire)
        case "error":
            return Problem(wire["problem"], seq=wire.get("seq"), ref=wire.get("ref"))
        case "targets":
            return Targets.of(wire)
        case "ready":
            return Ready.of(wire)
        case "draining":
            return Draining(wire["reconnect_in_s"], wire.get("resumable", True))
        case _:  # of a newer server
            return None


def _of_closed(closed: ConnectionClosed) -> Problem | ConnectionLost:
    code, reason = (closed.rcvd.code, closed.rcvd.reason) if closed.rcvd else (1006, "")
    return of_close(code, reason) or ConnectionLost(f"the stream broke off: {code} {reason}".rstrip())


def problem_of(status: int, body: bytes, way: str = "") -> Problem:
    """The problem in an HTTP answer; of any other body, a proxy's say, the status and the ``way`` are told."""
    try:
        members = json.loads(body)
        return Problem({"status": status} | members)
    except (ValueError, TypeError):
        return Problem({"code": "internal", "status": status, "detail": f"HTTP {status}{way}"})
