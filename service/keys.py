"""API keys: what the service keeps of them, and the file that they may be read from."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

LEAST_CHARACTERS = 16
# Of a digest, as the name of an owner: enough to tell any two keys apart.
NAME_CHARACTERS = 32


@dataclass(frozen=True, slots=True)
class Identity:
    """The owner, an opaque name, and the digest of the key that was shown for it."""

    owner: str
    key: bytes


def digest(secret: str) -> bytes:
    """What is kept and compared instead of a secret."""
    return hashlib.sha256(secret.encode()).digest()


def by_digest(keys: Iterable[str]) -> dict[bytes, str]:
    """The owner of each key by its digest; every key is an owner of its own."""
    return {digest(key): digest(key).hex()[:NAME_CHARACTERS] for key in keys}


def read_keys(path: Path) -> dict[bytes, str]:
    """The owner of each key of a file by its digest; lines of the same name are keys of one owner.

    Raises ValueError, whose text holds no key.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as failed:
        raise ValueError("the file cannot be read") from failed
    owners: dict[bytes, str] = {}
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        *name, key = words
        if len(name) > 1:
            raise ValueError(f"line {number} is neither KEY nor NAME KEY")
        if len(key) < LEAST_CHARACTERS:
            raise ValueError(f"line {number}: a key has at least {LEAST_CHARACTERS} characters")
        owners |= {digest(key): f"name:{name[0]}"} if name else by_digest([key])
    if not owners:
        raise ValueError("the file holds no key")
    return owners
