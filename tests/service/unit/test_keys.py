"""The file of keys: how it may be written, and what happens while it is."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from service.auth import Authenticator
from service.keys import read_keys
from service.protocol.problems import ProblemError
from service.settings import Settings

KEYS = ["the-key-of-the-first-tenant", "the-key-of-the-second-one", "the-key-of-the-third-tenant"]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    file = tmp_path / "keys"
    file.write_text("".join(f"{key}\n" for key in KEYS))
    return file


def good(authenticator: Authenticator) -> list[str]:
    """The keys that the authenticator lets in."""

    def is_good(key: str) -> bool:
        try:
            authenticator.identify({"x-api-key": key})
        except ProblemError:
            return False
        return True

    return [key for key in KEYS if is_good(key)]


def write(file: Path, keys: list[str], cut: int | None = None) -> None:
    """In place, which leaves the inode; ``cut`` is where the writing has come to."""
    with file.open("w") as out:
        out.write("".join(f"{key}\n" for key in keys)[:cut])
    os.utime(file, ns=(0, write.count))  # type: ignore[attr-defined]
    write.count += 1  # type: ignore[attr-defined]


write.count = 1  # type: ignore[attr-defined]


def test_a_file_that_is_half_written_revokes_nobody(file: Path) -> None:
    authenticator = Authenticator(Settings(api_keys_file=file), lambda: 0.0)
    whole = len("".join(f"{key}\n" for key in KEYS))
    for cut in (0, 20, len(KEYS[0]) + 1, len(KEYS[0]) + 20, whole - 1):
        write(file, KEYS, cut)
        assert not authenticator.refresh()
        assert good(authenticator) == KEYS
    write(file, KEYS[1:])
    assert not authenticator.refresh()
    assert authenticator.refresh()
    assert good(authenticator) == KEYS[1:]
    assert not authenticator.refresh()


def test_a_file_that_is_written_while_it_is_read_is_read_again(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    authenticator = Authenticator(Settings(api_keys_file=file), lambda: 0.0)
    write(file, KEYS[:2])
    assert not authenticator.refresh()

    def read_half(path: Path) -> dict[bytes, str]:
        write(file, KEYS[:1])
        half = read_keys(path)
        write(file, KEYS[:2])
        return half

    with monkeypatch.context() as patch:
        patch.setattr("service.auth.read_keys", read_half)
        assert not authenticator.refresh()
    assert good(authenticator) == KEYS
    assert not authenticator.refresh()
    assert authenticator.refresh()
    assert good(authenticator) == KEYS[:2]


def test_a_file_that_vanishes_or_is_emptied_changes_nothing(file: Path) -> None:
    authenticator = Authenticator(Settings(api_keys_file=file), lambda: 0.0)
    write(file, [])
    assert not authenticator.refresh()
    assert not authenticator.refresh()
    file.unlink()
    assert not authenticator.refresh()
    assert not authenticator.refresh()
    assert good(authenticator) == KEYS
    write(file, KEYS[:1])
    authenticator.refresh()
    assert authenticator.refresh()
    assert good(authenticator) == KEYS[:1]


def test_a_file_that_vanishes_before_it_is_read_lets_nobody_in(file: Path) -> None:
    """Not everybody, as a service without keys does."""
    settings = Settings(api_keys_file=file)
    content = file.read_text()
    file.unlink()
    authenticator = Authenticator(settings, lambda: 0.0)
    assert good(authenticator) == []
    file.write_text(content)
    authenticator.refresh()
    assert authenticator.refresh()
    assert good(authenticator) == KEYS


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_files_as_editors_save_them(tmp_path: Path, encoding: str, end: str) -> None:
    file = tmp_path / "keys"
    file.write_bytes(end.join(KEYS).encode(encoding))
    assert good(Authenticator(Settings(api_keys_file=file), lambda: 0.0)) == KEYS


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (KEYS[0].encode("utf-16"), "save it as UTF-8"),
        (KEYS[0].encode("utf-16-le"), "save it as UTF-8"),
        (b"\xff" + KEYS[0].encode(), "save it as UTF-8"),
        ("a-key-of-an-öperator".encode(), "line 1: a key has printable ASCII characters only"),
        (b"# a comment\nshort", "line 2: a key has at least 16 characters"),
        (b"one name too-many-words-in-a-line", "line 1 is neither"),
        (b"\xef\xbb\xbf# nothing else\r\n", "holds no key"),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path: Path, data: bytes, complaint: str) -> None:
    file = tmp_path / "keys"
    file.write_bytes(data)
    with pytest.raises(ValueError, match=complaint) as refused:
        Settings(api_keys_file=file)
    assert KEYS[0] not in str(refused.value)


def test_one_tenants_tickets_do_not_push_out_anothers() -> None:
    now = 0.0
    authenticator = Authenticator(Settings(api_keys=",".join(KEYS), max_tickets=2), lambda: now)
    mine, other = (authenticator.identify({"x-api-key": key}) for key in KEYS[:2])
    ticket = authenticator.issue(other, "theirs", 30)
    issued = [authenticator.issue(mine, "mine", 30) for _ in range(5)]
    assert authenticator.redeem([f"mfcmt.ticket.{ticket}"], "theirs") == other
    with pytest.raises(ProblemError, match="unauthenticated"):
        authenticator.redeem([f"mfcmt.ticket.{issued[2]}"], "mine")
    assert authenticator.redeem([f"mfcmt.ticket.{issued[4]}"], "mine") == mine
    now = 31.0
    authenticator.sweep()
    assert len(authenticator._tickets) == 0
