"""Every exchange is answered as it was when it was recorded; what may differ is in the rules of ``tape.py``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from service.load.own import OwnServer

from . import saved
from .packed import text_of
from .record import RESTART, TRANSCRIPTS
from .scenarios import SCENARIOS, SERVERS, restart, run
from .tape import difference, masked


@pytest.fixture(scope="module")
def servers() -> Iterator[dict[str, OwnServer]]:
    with ExitStack() as stack:
        yield {name: stack.enter_context(OwnServer(**settings)) for name, settings in SERVERS.items()}


@pytest.mark.parametrize("name", SCENARIOS)
def test_exchange_is_answered_as_recorded(name: str, servers: dict[str, OwnServer]) -> None:
    recorded = (TRANSCRIPTS / f"{name}.txt").read_text(encoding="utf-8")
    assert difference(recorded, run(name, servers[SCENARIOS[name][0]])) == ""


def test_stream_is_resumed_after_restart_as_recorded(tmp_path: Path) -> None:
    with OwnServer(state_dir=tmp_path, **RESTART) as server:
        recorded = (TRANSCRIPTS / "restart.txt").read_text(encoding="utf-8")
        assert difference(recorded, restart(server)) == ""


@pytest.mark.parametrize("way", saved.WAYS)
def test_state_saved_by_an_earlier_version_is_taken_up(way: str) -> None:
    recorded = (saved.STATE / f"{way}.txt").read_text(encoding="utf-8")
    assert difference(recorded, saved.take_up(way)) == ""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('{"a":1}', '{"a":1.0}'),
        ('{"a":1.5}', '{"a":1.51}'),
        ('{"a":1.5}', '{"a":1.50}'),
        ('{"a":1.5,"b":2}', '{"b":2,"a":1.5}'),
        ('{"a":1.5}', '{"a": 1.5}'),
        ("one line", "one line\nanother"),
    ],
)
def test_difference_is_seen(old: str, new: str) -> None:
    assert difference(old, new)


def test_rounding_is_no_difference() -> None:
    assert difference('{"a":1.5,"b":[100.123456]}', '{"a":1.5000001,"b":[100.123457]}') == ""


@pytest.mark.parametrize(
    ("written", "kept"),
    [
        ('{"queue_ms":1.25,"track_ms":0.0}', '{"queue_ms":<duration>,"track_ms":<duration>}'),
        ('{"title":"a \\"b\\"","status":400}', '{"title":"<sentence>","status":400}'),
        ('{"created_at":"2026-01-02T03:04:05.678Z"}', '{"created_at":"<instant>"}'),
        ('{"code":"over-credit","retry_after_s":0.1}', '{"code":"over-credit","retry_after_s":0.1}'),
    ],
)
def test_variable_parts_are_masked_and_nothing_else(written: str, kept: str) -> None:
    assert masked(written) == kept


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"\x82\xa1a\x01\xa1b\xc0", '{"a":1,"b":null}'),
        (b"\x81\xa1a\xcc\x01", '{"a":uint1:1}'),
        (b"\xca\x3f\x80\x00\x00", "float4:1.0"),
        (b"\xcb\x3f\xf0\x00\x00\x00\x00\x00\x00", "1.0"),
        (b"\xdc\x00\x01\xff", "array2:[-1]"),
        (b"\xcd\x01\x00", "256"),
        (b"\xd9\x01a", 'str1:"a"'),
    ],
)
def test_every_byte_of_messagepack_is_in_its_text(data: bytes, text: str) -> None:
    assert text_of(data) == text
