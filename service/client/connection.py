"""One connection of a stream, as it is: it does not wait for credit and does not reconnect."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Literal, cast

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException
from websockets.typing import Subprotocol

from ..protocol import answers
from ..protocol.codecs import CODECS, Codec
from .address import Address
from .errors import ConnectionLost, Problem, of_close
from .types import Draining, Frame, Mode, Ready, Result, Targets, read_answer

Protocol = Literal["mfcmt.v1.msgpack", "mfcmt.v1.json"]
Message = Ready | Result | Targets | Draining | Problem

MESSAGES: dict[str, type[Any]] = {kind.TYPE: kind for kind in answers.STREAM_MESSAGES}

MAX_MESSAGE_BYTES = 64 * 1024 * 1024


class _Handshake(connect):
    """A handshake that does not follow redirects by itself: it would leave the key out."""

    def process_redirect(self, exc: Exception) -> Exception:
        return exc


class Connection:
    """An open attachment; made by :meth:`open`."""

    def __init__(self, socket: ClientConnection, codec: Codec) -> None:
        self._socket = socket
        self._codec = codec

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

        Parameters
        ----------
        ticket
            Admits this handshake, in place of the address's key.
        takeover
            End another attachment of the session.
        resume
            End the attachment of this name, and no other.

        Raises
        ------
        Problem
            The service refuses.
        ConnectionLost
            The service cannot be reached.
        """
        query: dict[str, str] = {"mode": mode}
        if takeover:
            query["takeover"] = "true"
        if resume is not None:
            query["resume"] = resume
        protocols: list[str] = [protocol] if ticket is None else [protocol, f"mfcmt.ticket.{ticket}"]
        try:
            socket = await _Handshake(
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
        return cls(socket, CODECS[protocol])

    async def send_frame(self, frame: Frame) -> None:
        """Send one frame. Raises what :meth:`receive` raises."""
        meta = {"seq": frame.seq, "ts": frame.ts, "region": frame.region}
        meta = {name: value for name, value in meta.items() if value is not None}
        for message in self._codec.frame(frame.data, meta):
            await self._send(message)

    async def send_control(self, control: Mapping[str, Any]) -> None:
        """Send ``add``, ``correct`` or ``remove``. Raises what :meth:`receive` raises."""
        await self._send(self._codec.encode(control))

    async def receive(self) -> Message:
        """Return the next message; the refusal of a message is returned as a :class:`Problem`, not raised.

        Raises
        ------
        Problem
            The service has ended the attachment for good.
        ConnectionLost
            The connection broke; the stream may be resumed.
        """
        while True:
            try:
                data = await self._socket.recv()
            except ConnectionClosed as closed:
                raise _of_closed(closed) from closed
            message = _message(self._codec.decode(data))
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


def _message(sent: Any) -> Message | None:
    """Return a message of the service; None for one of a type that only a newer service has."""
    kind = MESSAGES.get(sent["type"])
    if kind is None:
        return None
    if kind is answers.Error:
        return Problem(sent["problem"], seq=sent.get("seq"), ref=sent.get("ref"))
    message: Message = read_answer(kind, sent)
    return message


def _of_closed(closed: ConnectionClosed) -> Problem | ConnectionLost:
    code, reason = (closed.rcvd.code, closed.rcvd.reason) if closed.rcvd else (1006, "")
    return of_close(code, reason) or ConnectionLost(f"the stream broke off: {code} {reason}".rstrip())


def problem_of(status: int, body: bytes, way: str = "") -> Problem:
    """Return the problem in an HTTP answer.

    For any other body, such as a proxy's, it holds the status and the ``way`` to the service.
    """
    try:
        members = json.loads(body)
        return Problem({"status": status} | members)
    except (ValueError, TypeError):
        return Problem({"code": "internal", "status": status, "detail": f"HTTP {status}{way}"})
