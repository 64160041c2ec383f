"""A camera behind a narrow uplink: pictures become smaller until ten of them a second fit."""

from __future__ import annotations

import asyncio
from pathlib import Path

from mfcmt_core import synthetic
from service.load.clips import encode
from service.load.own import OwnServer

from .conftest import Open, launched, loop
from .tap import Tap

pytestmark = loop
BITS_PER_S = 750_000
AT_LEAST = 10  # results a second
CHUNK = 1500
LAST = 5


class Narrow(Tap):
    """A cable whose way to the server carries so many bits a second."""

    async def _carry(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        if sink.get_extra_info("peername")[1] == self._port:
            source = _Slow(source)  # type: ignore[assignment]
        await super()._carry(source, sink)


class _Slow:
    def __init__(self, reader: asyncio.StreamReader) -> None:
        self._reader = reader

    async def read(self, _most: int) -> bytes:
        data = await self._reader.read(CHUNK)
        await asyncio.sleep(len(data) * 8 / BITS_PER_S)
        return data


async def test_ten_pictures_a_second_come_to_fit(open_page: Open, server: OwnServer, tmp_path: Path) -> None:
    clip = synthetic.clip("sample")
    film = tmp_path / "camera.mjpeg"
    film.write_bytes(b"".join(encode(frame) for frame in clip.frames))
    camera = ["--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream"]
    async with (
        launched([*camera, f"--use-file-for-fake-video-capture={film}"]) as browser,
        Narrow(server.port) as line,
        open_page(line.url, browser=browser) as user,
    ):
        await user.choose("camera")
        await user.until("document.getElementById('picture').width > 100")
        await user.draw((200, 150, 200, 200))
        await user.frames(2)
        first = sizes(line)[0]
        assert first > fits() * 1.5, "the picture is no test"
        async with asyncio.timeout(120):
            while max(sizes(line)[-LAST:]) > fits():
                await user.frames(1)
        await user.frames(10)  # tracking goes on in the small pictures, with boxes in pixels of the camera
        assert (await user.boxes())["frames"][-1]["size"] == [640, 480]


def fits() -> float:
    """How large a picture may be."""
    return BITS_PER_S / 8 / AT_LEAST


def sizes(line: Tap) -> list[int]:
    """Of the pictures that were sent in the stream, in bytes."""
    return [len(message) for message in line.streams()[-1][0] if isinstance(message, bytes)]
