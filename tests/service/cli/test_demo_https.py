"""``mfcmt demo --https``: what a phone meets that scans the code in the terminal."""

from __future__ import annotations

import hashlib
import http.client
import re
import shutil
import signal
import socket
import ssl
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from mfcmt_core.cli import UsageError, main
from service.certificate import CertificateError, check_pair, self_signed
from service.cli import phone
from service.client import Client
from service.load.clips import open_clip
from tests.conftest import require

MFCMT = "import sys; from mfcmt_core.cli import main; sys.exit(main())"
# Pixels of a QR code's modules in the picture that a phone would take of it.
MODULE_PX = 8
HALVES = {" ": (0, 0), "▀": (255, 0), "▄": (0, 255), "█": (255, 255)}


@dataclass
class Demo:
    """What it printed, and the client's TLS context that trusts its certificate."""

    code: str
    url: str
    certificate: str
    trust: ssl.SSLContext


@pytest.fixture(scope="module")
def demo() -> Iterator[Demo]:
    require(shutil.which("openssl"), "no openssl is installed")
    command = [sys.executable, "-c", MFCMT, "demo", "--https", "--host", address()]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines: list[str] = []
        while not (lines and lines[-1].startswith("the page is at ")):
            line = process.stdout.readline()
            assert line, "it ended"
            lines.append(line)
        url = lines[-1].split()[4]
        where = urlsplit(url)
        pem = ssl.get_server_certificate((where.hostname or "", where.port or 0))
        yield Demo("".join(lines[:-1]), url, pem, ssl.create_default_context(cadata=pem))
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
        assert process.returncode == 0


def address() -> str:
    """This machine's in its network; loopback where it has none."""
    try:
        return phone.network_address()
    except UsageError:
        return "127.0.0.1"


def read(code: str) -> str:
    """What a phone's camera makes of the lines of a terminal."""
    lines = [line for line in code.splitlines() if set(line) <= set(HALVES) and line]
    rows = [[HALVES[char][half] for char in line] for line in lines for half in (0, 1)]
    picture = np.array(rows, np.uint8).repeat(MODULE_PX, axis=0).repeat(MODULE_PX, axis=1)
    return cv2.QRCodeDetector().detectAndDecode(picture)[0]


def test_the_code_in_the_terminal_is_the_address(demo: Demo) -> None:
    assert read(demo.code) == demo.url
    assert re.fullmatch(r"https://[0-9.]+:[0-9]+", demo.url)


def test_the_page_and_a_stream_come_by_tls(demo: Demo, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The certificate is of the address, and the service answers to it and to its page without a key."""
    connection = http.client.HTTPSConnection(urlsplit(demo.url).netloc, context=demo.trust, timeout=30)
    connection.request("GET", "/", headers={"Origin": demo.url})
    page = connection.getresponse()
    assert page.status == 200
    assert b"<title>MFCMT" in page.read()
    (tmp_path / "trusted.pem").write_text(demo.certificate)
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "trusted.pem"))
    sample = open_clip(None, None, 3)
    with Client(demo.url) as client, client.create(sample.frames[0], sample.box) as session:
        results = list(session.stream(sample.frames[1:], mode="lossless"))
    assert [result.seq for result in results] == [1, 2]


def test_plain_http_gets_no_answer(demo: Demo) -> None:
    where = urlsplit(demo.url)
    with socket.create_connection((where.hostname or "", where.port or 0), timeout=30) as plain:
        plain.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
        with suppress(ConnectionResetError):
            assert not plain.recv(1000).startswith(b"HTTP/1.1 200")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--host", "127.0.0.1"], "--host goes with --https"),
        (["--https", "--host", "phone.local"], "--host is an IP address"),
        (["--https", "--host", "0.0.0.0"], "that the phone shall open"),
    ],
)
def test_an_address_that_cannot_be_is_one_line(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", *arguments]) == 2
    assert says in capsys.readouterr().err


def test_without_openssl_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["demo", "--https", "--host", "127.0.0.1"]) == 1
    assert (
        "mfcmt demo: the certificate is made by the command openssl, which is not installed" in capsys.readouterr().err
    )


def test_files_that_are_no_pair_are_refused(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "other").mkdir()
    certificate, key = self_signed(tmp_path / "one", "127.0.0.1")
    check_pair(certificate, key)
    _, another = self_signed(tmp_path / "other", "127.0.0.1")
    assert hashlib.sha256(key.read_bytes()).digest() != hashlib.sha256(another.read_bytes()).digest()
    with pytest.raises(CertificateError, match="of one pair"):
        check_pair(certificate, another)
    with pytest.raises(CertificateError, match="cannot be read"):
        check_pair(tmp_path / "none.pem", key)
