"""What a user of the Python client gives wrongly is told at once, before anything is sent."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.client import AsyncClient, Client
from service.client.sources import as_frame, image_bytes, numbers
from service.client.types import Frame


@pytest.mark.parametrize(
    "url",
    [
        "ws://127.0.0.1:8000",
        "wss://tracking.test",
        "ftp://tracking.test",
        "127.0.0.1:8000",
        "localhost:8000",
        "localhost",
        "//localhost",
        "/v1",
        "http://",
        "http:///v1",
        "http://:8000",
        "http://tracking.test:99999",
        "http://tracking.test:0",
        "http://tracking.test:port",
        "http://::1:8000",
        "http://[::1",
        "",
        None,
        b"http://tracking.test",
    ],
)
def test_a_wrong_url_is_refused_at_once(url: Any) -> None:
    before = threading.enumerate()
    with pytest.raises(ValueError, match="url must be http:// or https://"):
        Client(url)
    assert threading.enumerate() == before


@pytest.mark.parametrize("url", ["http://h?x=1", "http://h/#top", "http://me:secret@h", "http://me@h:80/x"])
def test_a_url_with_more_than_a_base_is_refused(url: str) -> None:
    with pytest.raises(ValueError, match=r"^url .* without a query|^url must not contain a user") as refused:
        AsyncClient(url)
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize(
    ("url", "base", "stream"),
    [
        ("http://h", "http://h", "ws://h"),
        ("HTTPS://h:8443/", "https://h:8443", "wss://h:8443"),
        (" http://h:80/a/prefix//\n", "http://h:80/a/prefix", "ws://h:80/a/prefix"),
        ("http://[::1]:8000", "http://[::1]:8000", "ws://[::1]:8000"),
    ],
)
def test_a_url_may_have_a_port_and_a_prefix(url: str, base: str, stream: str) -> None:
    address = AsyncClient(url).address
    assert address.url == base
    assert address.stream("id", {"mode": "latest"}) == f"{stream}/v1/sessions/id/stream?mode=latest"


@pytest.mark.parametrize("key", ["from-a-file\n", "two words", "schlüssel"])
def test_a_key_that_no_header_can_carry_is_refused_and_not_shown(key: str) -> None:
    with pytest.raises(ValueError, match=r"^key must not contain spaces") as refused:
        AsyncClient(key=key)
    assert key.strip() not in str(refused.value)


async def test_an_image_is_bytes_or_a_path(tmp_path: Path) -> None:
    file = tmp_path / "0001.jpg"
    file.write_bytes(b"\xff\xd8")
    buffer = np.frombuffer(b"\xff\xd8", np.uint8)  # as cv2.imencode gives it
    for image in (b"\xff\xd8", bytearray(b"\xff\xd8"), memoryview(b"\xff\xd8"), file, buffer):
        assert await image_bytes(image) == b"\xff\xd8"
        assert await as_frame(Frame(image, ts=1)) == Frame(b"\xff\xd8", ts=1)  # type: ignore[arg-type]
    with pytest.raises(FileNotFoundError):
        await image_bytes(tmp_path / "none.jpg")


async def test_what_is_no_image_is_told_what_to_do() -> None:
    with pytest.raises(TypeError, match=r"pixels .*ndarray.*cv2\.imencode"):
        await AsyncClient().create(np.zeros((8, 8, 3), np.uint8), (0, 0, 4, 4))  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"bytes or a Path, not str; a file is Path\("):
        await AsyncClient().create("0001.jpg", (0, 0, 4, 4))  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="not NoneType"):
        await as_frame(None)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="a snapshot is bytes or a Path"):
        await AsyncClient().restore("file")  # type: ignore[arg-type]


def test_a_box_is_four_numbers() -> None:
    assert numbers((1, 2.5, 3, 4)) == numbers(np.array([1, 2.5, 3, 4])) == [1.0, 2.5, 3.0, 4.0]
    wrong: list[Any] = ["1,2,3,4", b"1234", "1234", (1, 2, 3), [(1, 2, 3, 4)], 7, None, {"x": 1}]
    for box in wrong:
        with pytest.raises(ValueError, match=r"a box is four numbers, \(x, y, w, h\), not "):
            numbers(box)
