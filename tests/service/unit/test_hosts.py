"""The hosts by which a service without keys may be called: nobody's page can reach it by a name of his own."""

from __future__ import annotations

import pytest

from service.auth import Authenticator
from service.protocol.problems import ProblemError
from service.settings import Settings

KEYS = "the-key-of-the-first-tenant"


def called(name: str | None, **settings: object) -> str | None:
    """The code with which a page of that very host is refused."""
    authenticator = Authenticator(Settings(**settings), lambda: 0.0)  # type: ignore[arg-type]
    headers = {} if name is None else {"host": name, "origin": f"http://{name}"}
    try:
        authenticator.check_browser(headers)
    except ProblemError as refused:
        return refused.code
    return None


@pytest.mark.parametrize(
    "host",
    [
        "localhost",
        "LocalHost:8000",
        "localhost.:8000",
        "page.localhost:8000",
        "127.0.0.1",
        "127.0.0.1:8000",
        "127.8.8.8:1",
        "[::1]",
        "[::1]:8000",
        "192.168.1.7:8000",
        "[fe80::1]:8000",
        None,
    ],
)
def test_names_that_nobody_else_can_have_are_good(host: str | None) -> None:
    """A name for an address can be pointed elsewhere; an address itself cannot."""
    assert called(host) is None


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:8000",
        "127.0.0.1.evil.example:8000",
        "localhost.evil.example",
        "notlocalhost",
        "[::1].evil.example",
        "[::1",
        "évil.example",
        "-",
        ":8000",
    ],
)
@pytest.mark.parametrize("listen", ["127.0.0.1", "0.0.0.0"])
def test_other_names_are_refused(host: str, listen: str) -> None:
    assert called(host, host=listen, allow_unauthenticated=True) == "host-refused"


def test_the_operator_names_others() -> None:
    settings = {"public_url": "https://Track.example:8443/mfcmt", "host": "box.lan", "allow_unauthenticated": True}
    for host in ("track.example:8443", "track.example", "TRACK.EXAMPLE.", "box.lan:8000"):
        assert called(host, **settings) is None
    assert called("other.example", **settings) == "host-refused"
    assert called("evil.example", public_url="http://[::1]:8000") == "host-refused"


def test_where_keys_are_needed_any_name_will_do() -> None:
    assert called("any.example", api_keys=KEYS) is None
