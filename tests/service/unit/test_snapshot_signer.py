"""The envelope of snapshots: who signed it for whom, in which version, and nothing read before that is known."""

from __future__ import annotations

import hashlib
import hmac
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.snapshot_signer import MAGIC, READABLE, VERSION, BadSignature, SnapshotSigner

OLD, NEW = b"the secret of last year", b"the secret of this year"
BODY = b"what a lane wrote" * 10


def version_1(secret: bytes, owner: str, body: bytes) -> bytes:
    """What release 0.1's first services wrote: the previous format, kept here as it was."""
    name = owner.encode()
    mac = hmac.new(secret, struct.pack(">HH", 1, len(name)) + name + body, hashlib.sha256).digest()
    return b"MFCMTS" + struct.pack(">H", 1) + mac + body


def refusal(seal: SnapshotSigner, owner: str, data: bytes) -> str:
    with pytest.raises(BadSignature) as refused:
        seal.verify(owner, data)
    return str(refused.value)


@given(owner=st.text(max_size=40), body=st.binary(max_size=2000))
def test_signed_snapshot_is_verified(owner: str, body: bytes) -> None:
    seal = SnapshotSigner([NEW, OLD])
    data = seal.sign(owner, body)
    assert data[:8] == MAGIC + struct.pack(">H", VERSION)
    assert seal.verify(owner, data) == body


def test_the_current_and_the_previous_version_are_read() -> None:
    assert READABLE == (VERSION - 1, VERSION)
    seal = SnapshotSigner([NEW, OLD])
    for secret in (OLD, NEW):
        assert seal.verify("a", version_1(secret, "a", BODY)) == BODY
    assert refusal(seal, "b", version_1(OLD, "a", BODY)) == "the signature does not match"
    assert refusal(SnapshotSigner([NEW]), "a", version_1(OLD, "a", BODY)) == "the signature does not match"


def test_secrets_rotate() -> None:
    """The first signs, all verify; one that is dropped is no longer good."""
    before, during, after = SnapshotSigner([OLD]), SnapshotSigner([NEW, OLD]), SnapshotSigner([NEW])
    assert during.verify("a", before.sign("a", BODY)) == BODY
    assert after.verify("a", during.sign("a", BODY)) == BODY
    assert refusal(after, "a", before.sign("a", BODY)) == "the signature does not match"
    assert refusal(before, "a", during.sign("a", BODY)) == "the signature does not match"


def test_the_head_stands_before_the_body_that_it_signs() -> None:
    signer = SnapshotSigner([NEW])
    assert signer.verify("a", signer.head("a", BODY) + BODY) == BODY
    assert signer.sign("a", BODY) == signer.head("a", BODY) + BODY


@pytest.mark.parametrize("make", [SnapshotSigner([NEW]).sign, lambda owner, body: version_1(NEW, owner, body)])
def test_every_flipped_bit_is_refused(make: object) -> None:
    seal = SnapshotSigner([NEW])
    data = make("a", BODY)  # type: ignore[operator]
    for bit in range(len(data) * 8):
        broken = bytearray(data)
        broken[bit // 8] ^= 1 << bit % 8
        refusal(seal, "a", bytes(broken))


def test_every_other_length_is_refused() -> None:
    seal = SnapshotSigner([NEW])
    data = seal.sign("a", BODY)
    for length in range(len(data)):
        refusal(seal, "a", data[:length])
    refusal(seal, "a", data + b"\0")


def test_other_owner_and_unknown_version_are_refused() -> None:
    seal = SnapshotSigner([NEW])
    data = seal.sign("a", BODY)
    assert refusal(seal, "b", data) == "the signature does not match"
    for version in (0, 3, 65535):
        changed = data[:6] + struct.pack(">H", version) + data[8:]
        assert refusal(seal, "a", changed) == f"version {version} is not read here"
    # A version 2 that is passed off as version 1 is signed for another purpose.
    assert refusal(seal, "a", data[:6] + b"\0\1" + data[8:]) == "the signature does not match"


@given(data=st.binary(max_size=400))
def test_made_up_bytes_are_refused(data: bytes) -> None:
    seal = SnapshotSigner([NEW])
    for start in (b"", MAGIC, MAGIC + b"\0\1", MAGIC + b"\0\2"):
        refusal(seal, "a", start + data)


@given(owner=st.text(max_size=6), other=st.text(max_size=6), body=st.binary(max_size=40))
def test_owner_and_body_are_not_confused(owner: str, other: str, body: bytes) -> None:
    """No cut between the two is as good as another."""
    seal = SnapshotSigner([NEW])
    data = seal.sign(owner, other.encode() + body)
    if owner != owner + other:
        refusal(seal, owner + other, seal.sign(owner, other.encode() + body))
        assert seal.verify(owner, data) == other.encode() + body
