"""API keys: their digests, their owners, and the file from which they may be read."""

from __future__ import annotations

import hashlib
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

LEAST_CHARACTERS = 16
# Characters of a digest that name an owner: enough to tell any two keys apart.
NAME_CHARACTERS = 32


@dataclass(frozen=True, slots=True)
class Identity:
    """A caller: the owner, an opaque name, and the digest of the key that the caller showed."""

    owner: str
    key: bytes


def digest(secret: str) -> bytes:
    """Return the digest of a secret, which is kept and compared in its place."""
    return hashlib.sha256(secret.encode()).digest()


def by_digest(keys: Iterable[str]) -> dict[bytes, str]:
    """Return the owner of each key by its digest; every key has an owner of its own."""
    return {digest(key): digest(key).hex()[:NAME_CHARACTERS] for key in keys}


def check_key(key: str) -> None:
    """Raise ValueError for a key that no header can carry, or that can be guessed."""
    if not (key.isascii() and key.isprintable()):
        raise ValueError("a key has printable ASCII characters only: no header can carry others")
    if len(key) < LEAST_CHARACTERS:
        raise ValueError(f"a key has at least {LEAST_CHARACTERS} characters")


def read_keys(path: Path) -> dict[bytes, str]:
    """Return the owner of each key of a file by its digest; lines with the same name are keys of one owner.

    Raises ValueError, whose text never holds a key.
    """
    owners: dict[bytes, str] = {}
    for number, line in enumerate(_text(path).splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        *name, key = words
        if len(name) > 1:
            raise ValueError(f"line {number} is neither KEY nor NAME KEY")
        try:
            check_key(key)
        except ValueError as wrong:
            raise ValueError(f"line {number}: {wrong}") from None
        owners |= {digest(key): f"name:{name[0]}"} if name else by_digest([key])
    if not owners:
        raise ValueError("the file holds no key")
    return owners


def _text(path: Path) -> str:
    """Return the file's text without a byte order mark. Raises ValueError."""
    try:
        data = path.read_bytes()
    except OSError as failed:
        raise ValueError("the file cannot be read") from failed
    if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) or b"\0" in data:
        raise ValueError("the file is not UTF-8 but UTF-16 or binary: save it as UTF-8")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError("the file is not UTF-8: save it as UTF-8") from None
