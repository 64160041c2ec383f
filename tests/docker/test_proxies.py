"""Real nginx and Caddy with the files of docker/proxy, in front of a real server: our client over https and wss."""

from __future__ import annotations

import asyncio
import shutil
import socket
import ssl
import subprocess
import time
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx2
import pytest

from service.client import AsyncClient, Client
from service.load.clips import Clip, open_clip, sample
from service.load.own import OwnServer, free_port
from tests.conftest import OTB_ROOT, ROOT, require

HOST = "localhost"
KEY = "a-key-for-the-proxy-tests"


@dataclass
class Proxy:
    """Where it listens, and what is behind it."""

    url: str
    server: OwnServer


def changed(path: Path, certificate: Path, key: Path, port: int, behind: int, **more: str) -> str:
    """An example's text, with only the names of its surroundings changed."""
    text = path.read_text()
    changes = {
        "/etc/ssl/certs/tracker.pem": str(certificate),
        "/etc/ssl/private/tracker.key": str(key),
        "127.0.0.1:8000": f"127.0.0.1:{behind}",
        **more,
    }
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    assert str(port) in text
    return text


def nginx(folder: Path, certificate: Path, key: Path, port: int, behind: int) -> list[str]:
    changes = {"listen 443 ssl": f"listen 127.0.0.1:{port} ssl", "tracker.example.org": HOST, "75s": "2s"}
    site = changed(ROOT / "docker/proxy/nginx.conf", certificate, key, port, behind, **changes)
    (folder / "site.conf").write_text(site)
    (folder / "nginx.conf").write_text(
        f"pid {folder}/pid; error_log {folder}/log; daemon off;\nevents {{}}\n"
        f"http {{ access_log off; client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy;\n"
        f"fastcgi_temp_path {folder}/f; uwsgi_temp_path {folder}/u; scgi_temp_path {folder}/s;\n"
        f"include {folder}/site.conf; }}\n"
    )
    return ["nginx", "-e", f"{folder}/log", "-c", f"{folder}/nginx.conf"]


def caddy(folder: Path, certificate: Path, key: Path, port: int, behind: int) -> list[str]:
    changes = {
        "tracker.example.org": f"https://{HOST}:{port}",
        "75s": "2s",
        "{\n\tservers": "{\n\tadmin off\n\tservers",
    }
    text = changed(ROOT / "docker/proxy/Caddyfile", certificate, key, port, behind, **changes)
    (folder / "Caddyfile").write_text(text)
    return ["caddy", "run", "--config", f"{folder}/Caddyfile", "--adapter", "caddyfile"]


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    require(shutil.which("openssl"), "no openssl to make a certificate with")
    folder = tmp_path_factory.mktemp("tls")
    made, key = folder / "cert.pem", folder / "key.pem"
    words = f"req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN={HOST}"
    names = ["-addext", f"subjectAltName=DNS:{HOST}", "-keyout", str(key), "-out", str(made)]
    subprocess.run(["openssl", *words.split(), *names], check=True, capture_output=True)
    return made, key


@pytest.fixture(scope="module")
def behind() -> Iterator[OwnServer]:
    with OwnServer(lanes=1, api_keys=KEY, ping_interval_s=0.5) as server:
        yield server


@pytest.fixture(params=[nginx, caddy], ids=["nginx", "caddy"])
def proxy(
    request: pytest.FixtureRequest,
    tmp_path: Path,
    certificate: tuple[Path, Path],
    behind: OwnServer,
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[Proxy]:
    command: Callable[..., list[str]] = request.param
    require(shutil.which(command.__name__), f"no {command.__name__}")
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate[0]))
    for name in ("HOME", "XDG_DATA_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    port = free_port()
    words = command(tmp_path, *certificate, port, behind.port)
    with (tmp_path / "out").open("wb") as out:
        process = subprocess.Popen(words, stdout=out, stderr=out)
    try:
        give_up = time.monotonic() + 30
        while not listens(port):
            assert process.poll() is None, (tmp_path / "out").read_text()
            assert time.monotonic() < give_up, (tmp_path / "out").read_text()
            time.sleep(0.05)
        yield Proxy(f"https://{HOST}:{port}", behind)
    finally:
        process.terminate()
        process.wait(20)


def listens(port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(1)
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture(scope="module")
def clip() -> Clip:
    david = OTB_ROOT / "David"
    return open_clip(david, None, 40) if david.is_dir() else sample(40)


def test_http_and_stream_give_what_they_give_without_it(proxy: Proxy, clip: Clip) -> None:
    told = []
    for url in (proxy.server.url, proxy.url):
        with Client(url, key=KEY) as client:
            session = client.create(clip.frames[0], box=clip.box)
            assert session.info.stream_url.startswith(url.replace("http", "ws", 1))
            first = session.track(clip.frames[1])
            results = [first, *session.stream(clip.frames[2:], mode="lossless")]
            session.close()
        told.append([(result.seq, [target.box for target in result.targets]) for result in results])
    assert told[0] == told[1]
    assert len(told[1]) == len(clip.frames) - 1


async def test_a_quiet_stream_is_kept_open_by_pings(proxy: Proxy, clip: Clip) -> None:
    # the example's 75 s are 2 s here, the server's pings come every half second, the client sends none
    async with AsyncClient(proxy.url, key=KEY, ping_interval_s=60) as client:
        session = await client.create(clip.frames[0], box=clip.box)
        before = proxy.server.log.count("stream attached")

        async def frames() -> AsyncIterator[bytes]:
            yield clip.frames[1]
            await asyncio.sleep(5)  # what is tested
            yield clip.frames[2]

        seen = [result.seq async for result in session.stream(frames(), mode="lossless")]
        assert seen == [1, 2]
        assert proxy.server.log.count("stream attached") == before + 1
        await session.close()


def test_large_frames_pass_and_too_large_ones_are_told_by_the_service(proxy: Proxy, clip: Clip) -> None:
    context = ssl.create_default_context()
    with httpx2.Client(base_url=proxy.url, verify=context, headers={"X-API-Key": KEY}, timeout=30) as http:
        made = http.post("/v1/sessions", files={"frame": clip.frames[0]}, data={"box": ",".join(map(str, clip.box))})
        assert made.status_code == 201, made.text
        path = f"{made.headers['location']}/frames"
        headers = {"Content-Type": "image/jpeg"}
        # a JPEG may be followed by anything
        large = http.post(path, content=clip.frames[1] + bytes(6_000_000), headers=headers)
        assert large.status_code == 200, large.text
        above = http.post(path, content=clip.frames[1] + bytes(9_000_000), headers=headers)
        assert (above.status_code, above.json()["code"]) == (413, "frame-too-large")


def test_metrics_stay_inside(proxy: Proxy) -> None:
    context = ssl.create_default_context()
    with httpx2.Client(base_url=proxy.url, verify=context) as http:
        assert http.get("/livez").status_code == 200
        assert http.get("/metrics").status_code == 404
