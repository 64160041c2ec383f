"""Sends bad inputs to a real server and judges every answer.

An answer is right if it is a problem of the catalogue with its status, reveals nothing of the implementation, and
fits the input where that is known: for a damaged frame it must be the decoder's verdict, and a frame that can still be
decoded must give the library's box. As the library never saw the refused frames, that also shows that they changed
nothing.
"""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import httpx2
import msgpack
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from mfcmt_core import MFCMT
from mfcmt_core.images import FrameError, FrameLimits, inspect
from mfcmt_core.images.decode import decode
from service.load.clips import Clip
from service.protocol.problems import CATALOGUE, MEDIA_TYPE

from .mutate import Mutator

PATIENCE_S = 30.0
KINDS = 5
"""Of inputs: frames, messages, bodies, snapshots, heads."""
INSIDE = ("Traceback", 'File "', "/service/", "site-packages", ".py", "Exception", "object at 0x")
SNAPSHOT, JSON, MSGPACK = "application/vnd.mfcmt.snapshot", "application/json", "application/msgpack"
# How a stream may be closed whose messages cannot be read, or are too many that are refused.
CLOSES = (4400, 4429, 1002, 1007)


class Wrong(Exception):
    """The service gave a wrong answer."""


@dataclass(slots=True)
class Tally:
    """The results of the inputs of one kind."""

    tried: int = 0
    valid: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)


class Fuzz:
    """Sends bad inputs of all kinds to a service. ``clip`` has small frames."""

    def __init__(self, url: str, clip: Clip, seed: int) -> None:
        self._url, self._clip = url, clip
        self._make = Mutator(seed, clip.frame(1))
        self._http = httpx2.AsyncClient(base_url=url, timeout=PATIENCE_S)
        self._limits = FrameLimits()
        self._oracle = MFCMT()
        self._stream: ClientConnection
        self._seq = 0
        self._other = ""
        self._snapshot = b""

    async def run(self, count: int, tell: Callable[[str], None] = lambda _: None) -> dict[str, Tally]:
        """Send ``count`` inputs of each kind; ``tell`` is called with the kind of each."""
        tallies = {}
        async with self._http:
            sid = await self._create()
            self._oracle.init(decode(self._clip.frame(0), self._limits)[0], self._clip.box)
            url = f"ws{self._url[4:]}/v1/sessions/{sid}/stream?mode=lossless"
            async with connect(url, compression=None, max_size=None) as stream:
                await stream.recv()
                self._stream = stream
                for kind in (self._frame, self._message, self._body, self._snapshot_, self._head):
                    tally = tallies[kind.__name__.strip("_")] = Tally()
                    for _ in range(count):
                        await self._judged(tally, kind())
                        tell(kind.__name__.strip("_"))
                    # The undisturbed session still gives the library's results.
                    await self._judged(tally, self._good_frame(), bad=False)
        return tallies

    async def _judged(self, tally: Tally, attempt: Any, *, bad: bool = True) -> None:
        tally.tried += bad
        try:
            async with asyncio.timeout(PATIENCE_S):
                code = await attempt
        except Wrong as wrong:
            tally.wrong.append(str(wrong))
        except (TimeoutError, OSError, ConnectionClosed, httpx2.HTTPError) as failed:
            tally.wrong.append(f"{type(failed).__name__}: {failed}")
        else:
            tally.refused.update([code] if code else [])
            tally.valid += bad and not code

    async def _frame(self) -> str | None:
        """A damaged image."""
        return await self._tracked(self._make.frame())

    async def _good_frame(self) -> str | None:
        return await self._tracked(self._clip.frame(2))

    async def _tracked(self, data: bytes) -> str | None:
        """Send a frame and return its refusal. Raises Wrong for one that is not the decoder's, or another box."""
        self._seq += 1
        try:
            info = inspect(data, self._limits)
            if (info.width, info.height) == self._clip.size:
                image, expected = decode(data, self._limits)[0], None
            else:  # found before anything is decoded
                expected = "frame-size-changed"
        except FrameError as bad:
            expected = bad.code
        await self._stream.send(data)
        heard = json.loads(await self._stream.recv())
        if heard.get("seq") != self._seq:
            raise Wrong(f"frame {self._seq} was answered by {heard}")
        if heard["type"] == "error":
            code = _code(heard["problem"], heard["problem"]["status"])
            if code != expected:
                raise Wrong(f"{code} instead of {expected}")
            return code
        if expected:
            raise Wrong(f"tracked instead of {expected}")
        if list(self._oracle.update(image).box) != heard["targets"][0]["box"]:
            raise Wrong("another box than the library's")
        return None

    async def _message(self) -> str | None:
        """A damaged message on a stream of another session; both subprotocols."""
        kind = self._make.chance.choice(("json", "msgpack"))
        goods: list[dict[str, Any]] = [
            {"type": "meta", "seq": 5, "ts": 1.5, "region": [0, 0, 10, 10]},
            {"type": "add", "box": list(self._clip.box), "ref": "a"},
            {"type": "correct", "target": 0, "box": list(self._clip.box)},
            {"type": "remove", "target": 9, "ref": 1},
            {"type": "frame", "frame": b"\xff\xd8\xff", "seq": 7},
        ]
        data = self._make.packed(self._make.changed(self._make.chance.choice(goods)), kind)
        url = f"ws{self._url[4:]}/v1/sessions/{await self._session()}/stream?takeover=true"
        async with connect(url, compression=None, max_size=None, subprotocols=[f"mfcmt.v1.{kind}"]) as stream:  # type: ignore[list-item]
            await stream.recv()
            await stream.send(data.decode("utf-8", "replace") if kind == "json" else data)
            end = {"type": "remove", "target": 77, "ref": "end"}
            codes = []
            with suppress(ConnectionClosed):
                await stream.send(json.dumps(end) if kind == "json" else msgpack.packb(end))
            while True:
                try:
                    heard = await stream.recv()
                except ConnectionClosed as closed:
                    if closed.rcvd is None or closed.rcvd.code not in CLOSES:
                        raise Wrong(f"closed with {closed.rcvd}") from closed
                    return str(closed.rcvd.code)
                heard = msgpack.unpackb(heard) if isinstance(heard, bytes) else json.loads(heard)
                if heard["type"] == "error":
                    codes.append(_code(heard["problem"], heard["problem"]["status"]))
                if heard.get("ref") == "end":
                    return codes[0] if len(codes) > 1 else None

    async def _body(self) -> str | None:
        """A damaged body, or a query of nonsense, of any call."""
        chance, session = self._make.chance, f"/v1/sessions/{await self._session()}"
        kind = chance.choice((JSON, MSGPACK))
        good: dict[str, Any] = {"box": list(self._clip.box)}
        method, path = chance.choice((("POST", "/targets"), ("PUT", "/targets/0"), ("POST", "/ticket"), ("POST", "")))
        if not path:
            session, good["frame"] = "/v1/sessions", self._clip.frame(0) if kind == MSGPACK else "/9j/4AAQ"
            good["options"] = {"preset": "default", "label": "x", "idle_timeout_s": 5}
        elif path == "/ticket":
            good = {"ttl_s": 5}
        data = self._make.packed(self._make.changed(good), kind)
        if chance.random() < 0.3:
            names = ("seq", "ts", "region", "limit", "after", "format", "target")
            query = {chance.choice(names): chance.choice(("nan", "-1", "9" * 30, "1,2,3", "\x00", "x" * 500, ""))}
            path = chance.choice((f"{session}/frames", f"{session}/trajectory", "/v1/sessions"))
            return await self._call(chance.choice(("GET", "POST")), path, data, kind, query)
        return await self._call(method, session + path, data, kind)

    async def _snapshot_(self) -> str | None:
        """A damaged snapshot: never anything but bad-snapshot."""
        damaged = self._make.damaged(self._snapshot)
        code = await self._call("POST", "/v1/sessions", damaged, SNAPSHOT)
        if code != "bad-snapshot" and damaged != self._snapshot:
            raise Wrong(f"{code} instead of bad-snapshot")
        return code

    async def _head(self) -> str | None:
        """A damaged request, byte for byte: an answer that is one, or the end of the connection."""
        reader, writer = await asyncio.open_connection("127.0.0.1", httpx2.URL(self._url).port)
        writer.write(self._make.head(await self._session()))
        writer.write_eof()
        received = b""
        with suppress(ConnectionError):
            received = await reader.read()
        writer.close()
        if not received:
            return "closed"
        head, _, body = received.partition(b"\r\n\r\n")
        status = int(head.split(b" ", 2)[1])
        text = received.decode("latin-1")
        if any(word in text for word in INSIDE) or b"x-request-id" not in head.lower():
            raise Wrong(f"an answer of ours is not like this: {text[:200]}")
        if status >= 400 and b"problem+json" in head:
            return _code(json.loads(body), status)
        if status >= 400 and b"sec-websocket" not in text.lower().encode():
            raise Wrong(f"{status} without a problem")
        return None

    async def _call(self, method: str, path: str, data: bytes, kind: str, query: Any = None) -> str | None:
        response = await self._http.request(method, path, content=data, params=query, headers={"Content-Type": kind})
        if any(word in response.text for word in INSIDE) or "X-Request-ID" not in response.headers:
            raise Wrong(f"an answer of ours is not like this: {response.text[:200]}")
        if response.status_code < 400:
            if response.status_code == 201 and (place := response.headers.get("Location")):
                await self._http.delete(place)
            return None
        if not response.headers["Content-Type"].startswith(MEDIA_TYPE):
            raise Wrong(f"{response.status_code} without a problem")
        return _code(response.json(), response.status_code)

    async def _session(self) -> str:
        """Return the id of a session that may be changed, a new one if the last has ended."""
        path = f"/v1/sessions/{self._other}"
        if not self._other or (await self._http.get(path)).status_code != 200:
            self._other = await self._create()
            self._snapshot = (await self._http.get(f"/v1/sessions/{self._other}/snapshot")).content
        return self._other

    async def _create(self) -> str:
        response = await self._http.post(
            "/v1/sessions", files={"frame": self._clip.frame(0)}, data={"box": json.dumps(self._clip.box)}
        )
        sid: str = response.raise_for_status().json()["id"]
        return sid


def _code(problem: dict[str, Any], status: int) -> str:
    """Return the code of a refusal. Raises Wrong if it is not one of the catalogue, or a fault of the service."""
    code = problem.get("code", "")
    if code not in CATALOGUE or CATALOGUE[code].status != status or problem.get("status") != status:
        raise Wrong(f"{status} with {problem}")
    if status >= 500:
        raise Wrong(f"a fault of the service: {code}")
    if any(word in json.dumps(problem) for word in INSIDE):
        raise Wrong(f"{code} tells of the inside: {problem}")
    return str(code)
