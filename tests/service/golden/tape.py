"""One recorded exchange: what was sent and what came back, with what varies between two runs masked by rule.

Everything that a server answers is recorded byte for byte, the order of keys included, but for these:

* ids of sessions, tickets and attachments: named by the scenario when it meets them (:meth:`Tape.name`);
* the server's address, which has a free port;
* instants and durations: ``*_ms``, ``reconnect_in_s``, and ``retry_after_s`` of a rate;
* the header ``date``, and the number in ``content-length``, which is checked against the body instead;
* sentences for people: the ``title`` and ``detail`` of a problem and the reason of a close;
* versions of software;
* the pixels of response maps and the bytes of snapshots.

Numbers with a decimal point are compared within :data:`TOLERANCE`, because kernels compiled for another CPU may round
differently; how they are written is compared exactly.
"""

from __future__ import annotations

import base64
import json
import math
import os
import re
import signal
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2
import msgpack
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from service.load.own import OwnServer
from service.load.usage import server_processes

from .packed import image_or_bytes, text_of

HERE = Path(__file__).parent
JSON, MSGPACK = "mfcmt.v1.json", "mfcmt.v1.msgpack"
REQUEST_ID = "golden"
# Of a number with a decimal point, absolute where it is below 1. Kernels differ by units in the last of float32's
# seven places; a score divides peaks by means of them.
TOLERANCE = 1e-3

_INSTANT = re.compile(r"\b\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z")
_DURATION = re.compile(r'("\w+_ms":)\d+(?:\.\d{1,3})?(?=[,}])')
_RATE = re.compile(r'("code":"rate-limited","retry_after_s":)\d+(?:\.\d{1,3})?')
_RECONNECT = re.compile(r'("reconnect_in_s":)\d+\.\d{1,3}')
_SENTENCE = re.compile(r'("(?:title|detail)":)"(?:[^"\\]|\\.)*"')
_VERSION = re.compile(r'("(?:mfcmt|numpy|opencv|numba)":)"[^"]*"')
_PICTURE = re.compile(r'"(iVBORw0KGgo[A-Za-z0-9+/=]*)"')
_FLOAT = re.compile(r"(?<![\w.])-?\d+\.\d+(?:e[+-]?\d+)?(?![\w.])")
_VARIABLE_HEADERS = {"date": "<date>", "content-length": "<length>"}
_OMITTED_HEADERS = ("connection", "keep-alive")
_PAGE = re.compile(r'("next":)"\d+"')


def frame(index: int) -> bytes:
    """One of five frames of 160 x 120, in which a target moves a few pixels a frame."""
    return (HERE / "frames" / f"{index}.jpg").read_bytes()


# The target in frame 0.
BOX = [65.0, 48.0, 30.0, 24.0]


class Tape:
    """Records calls and streams of one server."""

    def __init__(self, server: OwnServer) -> None:
        self.lines: list[str] = []
        self._server, self._url = server, server.url
        self._names: dict[str, str] = {}
        # No connection is used twice: the server may be another process by then.
        limits = httpx2.Limits(max_keepalive_connections=0)
        self._http = httpx2.Client(base_url=self._url, timeout=30, limits=limits)
        for header in ("accept", "accept-encoding", "user-agent"):
            del self._http.headers[header]

    @property
    def text(self) -> str:
        """All that was recorded."""
        return "\n".join(self.lines) + "\n"

    @property
    def address(self) -> str:
        """The server's host and port."""
        return self._url.removeprefix("http://")

    def name(self, value: str, kind: str) -> str:
        """Have ``value`` written as the next of its kind, as in ``<session 2>``, also where it is written already."""
        if value not in self._names:
            count = sum(name.startswith(f"<{kind} ") for name in self._names.values())
            self._names[value] = f"<{kind} {count + 1}>"
            self.lines = [line.replace(value, self._names[value]) for line in self.lines]
        return value

    def say(self, text: str) -> None:
        """Write a heading."""
        self.lines.append(f"# {text}")

    @contextmanager
    def lane_suspended(self) -> Iterator[None]:
        """Keep the server's first lane from working in this block, so that what is sent to it is not answered."""
        lane = server_processes(self._server.pid)["lane 0"]
        os.kill(lane, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(lane, signal.SIGCONT)

    def call(
        self,
        method: str,
        path: str,
        *,
        headers: Mapping[str, str] | None = None,
        note: str = "",
        shown: str = "",
        **body: Any,
    ) -> httpx2.Response:
        """Make a call and record the answer; ``note`` and ``shown`` say in the transcript what body and path were."""
        sent = {"X-Request-ID": REQUEST_ID} | dict(headers or {})
        response = self._http.request(method, path, headers=sent, **body)
        named = [f"{name}: {value}" for name, value in (headers or {}).items()]
        self._write(">", "  ".join([f"{method} {shown or path}", *named, *filter(None, [note])]))
        self.answered(response.status_code, response.headers.multi_items(), response.content)
        return response

    def quiet(self, method: str, path: str, **body: Any) -> httpx2.Response:
        """Make a call that is not recorded."""
        return self._http.request(method, path, **body)

    def answered(self, status: int, headers: list[tuple[str, str]], content: bytes) -> None:
        """Record an answer of HTTP."""
        self._write("<", str(status))
        kind = ""
        for header, value in sorted((name.lower(), value) for name, value in headers):
            if header == "content-type":
                kind = value
            if header == "content-length":
                assert int(value) == len(content) or not content, (value, len(content))
            if header not in _OMITTED_HEADERS:
                self._write("<", f"{header}: {_VARIABLE_HEADERS.get(header, value)}")
        for line in _lines(kind, content) if content else ():
            self._write("<", line)

    def end_sessions(self) -> None:
        """End all sessions, unrecorded: those of one scenario are not in the lists of the next."""
        for value, name in self._names.items():
            if name.startswith("<session"):
                self._http.delete(f"/v1/sessions/{value}")

    @contextmanager
    def stream(self, sid: str, query: str = "", protocol: str = JSON, **headers: str) -> Iterator[Talk]:
        """Attach a stream and record its handshake."""
        path = f"/v1/sessions/{sid}/stream" + (f"?{query}" if query else "")
        self._write(">", f"WebSocket {path}  {protocol}")
        sent = {"X-Request-ID": REQUEST_ID} | {name.replace("_", "-"): value for name, value in headers.items()}
        with connect(
            f"ws{self._url[4:]}{path}",
            subprotocols=[part for part in protocol.split(", ") if part] or None,  # type: ignore[arg-type]
            additional_headers=sent,
            compression=None,
            max_size=None,
            user_agent_header=None,
        ) as socket:
            self._write("<", f"subprotocol: {socket.subprotocol}")
            talk = Talk(self, socket)
            yield talk
        if talk.attached:
            self._wait_until_detached(sid)

    def _wait_until_detached(self, sid: str) -> None:
        """Wait until the server has noticed that a stream has ended."""
        give_up = time.monotonic() + 10
        while '"attached":true' in self._http.get(f"/v1/sessions/{sid}").text:
            assert time.monotonic() < give_up
            time.sleep(0.01)

    def _write(self, direction: str, text: str) -> None:
        for value, name in self._names.items():
            text = text.replace(value, name)
        self.lines.append(f"{direction} {masked(text.replace(self.address, '<address>'))}")


class Talk:
    """A stream whose messages are recorded."""

    def __init__(self, tape: Tape, socket: ClientConnection) -> None:
        self._tape, self._socket = tape, socket
        self.attached = False
        self._packs = socket.subprotocol == MSGPACK

    def frame(self, data: bytes, note: str, **meta: Any) -> None:
        """Send a frame, with what is said about it."""
        if self._packs:
            self._tape._write(">", f"frame {note} {json.dumps(meta)}")
            self._socket.send(msgpack.packb({"type": "frame", **meta, "frame": data}))
            return
        if meta:
            self.send(type="meta", **meta)
        self._tape._write(">", f"frame {note}")
        self._socket.send(data)

    def send(self, **message: Any) -> None:
        """Send a message that is no frame."""
        self._tape._write(">", json.dumps(message))
        self._socket.send(msgpack.packb(message) if self._packs else json.dumps(message))

    def send_raw(self, data: str | bytes) -> None:
        """Send what is no message of the protocol."""
        self._tape._write(">", repr(data))
        self._socket.send(data)

    def hear(self) -> dict[str, Any]:
        """Record and return the next message."""
        data = self._socket.recv(30)
        message: dict[str, Any] = msgpack.unpackb(data) if isinstance(data, bytes) else json.loads(data)
        self._tape._write("<", text_of(data) if isinstance(data, bytes) else data)
        if message["type"] == "ready":
            self.attached = True
            self._tape.name(message["attachment"], "attachment")
        return message

    def closed(self) -> None:
        """Record how the server closes the stream; nothing else may come before."""
        with pytest.raises(ConnectionClosed) as end:
            self._socket.recv(30)
        said = end.value.rcvd
        self._tape._write("<", f"close {said.code} {'<reason>' if said.reason else ''}".rstrip() if said else "cut")


def _lines(kind: str, content: bytes) -> list[str]:
    if kind == "application/msgpack":
        return [text_of(content)]
    if kind.startswith(("application/vnd", "application/octet-stream")):
        return [f"<a snapshot: {content[:8]!r}...>"]
    return content.decode().splitlines()


def masked(text: str) -> str:
    """Return a line with all that varies between two runs, or is meant for people, replaced by a name."""
    text = _INSTANT.sub("<instant>", text)
    text = _DURATION.sub(r"\1<duration>", text)
    text = _RATE.sub(r"\1<duration>", text)
    text = _SENTENCE.sub(r'\1"<sentence>"', text)
    text = _RECONNECT.sub(r"\1<duration>", text)
    text = _PAGE.sub(r'\1"<page>"', text)
    text = _VERSION.sub(r'\1"<version>"', text)
    return _PICTURE.sub(_picture, text)


def _picture(found: re.Match[str]) -> str:
    return f"<base64 of {image_or_bytes(base64.b64decode(found[1]))}>"


def difference(recorded: str, now: str) -> str:
    """Say where two transcripts differ by more than the rounding of numbers; nothing if they do not."""
    before, after = recorded.splitlines(), now.splitlines()
    for number, (old, new) in enumerate(zip(before, after, strict=False), 1):
        if not _same(old, new):
            return f"line {number}\nrecorded: {old}\nnow:      {new}"
    if len(before) != len(after):
        longer = (before if len(before) > len(after) else after)[min(len(before), len(after))]
        return f"{len(before)} lines recorded, {len(after)} now; the first of those more: {longer}"
    return ""


def _same(old: str, new: str) -> bool:
    if old == new:
        return True
    if _FLOAT.sub("0.0", old) != _FLOAT.sub("0.0", new):
        return False
    return all(_close(a, b) for a, b in zip(_FLOAT.findall(old), _FLOAT.findall(new), strict=True))


def _close(old: str, new: str) -> bool:
    """Whether two numbers are the same but for rounding, and the new one is written as Python writes it."""
    well_written = repr(float(new)) == new
    return well_written and math.isclose(float(old), float(new), rel_tol=TOLERANCE, abs_tol=TOLERANCE)
