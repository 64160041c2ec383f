"""Real nginx and Caddy with the files of docker/proxy, in front of a real server: our client over https and wss."""

from __future__ import annotations

import asyncio
import http.client
import json
import os
import shutil
import socket
import ssl
import subprocess
import tempfile
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx2
import pytest

from service.client import AsyncClient, Client
from service.load.clips import Clip, open_clip, sample
from service.load.own import OwnServer, free_port
from service.protocol.problems import CATALOGUE, MEDIA_TYPE
from tests.conftest import OTB_ROOT, ROOT, require
from tests.programs import nginx_with, running

HOST = "localhost"
KEY = "a-key-for-the-proxy-tests"
STREAMS = 100
# without ports that belong to the machine
OWN_CADDY = "\tskip_install_trust\n\tadmin off\n\tauto_https disable_redirects"


@dataclass
class Proxy:
    """Where it listens, and what is behind it."""

    url: str
    server: OwnServer


@dataclass
class Started:
    """How to run a proxy: the command, and what it finds in its environment."""

    command: list[str]
    env: dict[str, str]


def changed(path: Path, changes: dict[str, str]) -> str:
    """An example's text, with only the names of its surroundings changed."""
    text = path.read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    return text


def nginx(folder: Path, certificate: tuple[Path, Path], port: int, behind: int, **more: str) -> Started:
    changes = {
        "/etc/ssl/certs/tracker.pem": str(certificate[0]),
        "/etc/ssl/private/tracker.key": str(certificate[1]),
        "127.0.0.1:8000": f"127.0.0.1:{behind}",
        "listen 443 ssl": f"listen 127.0.0.1:{port} ssl",
        "tracker.example.org": HOST,
        **more,
    }
    return Started(nginx_with(changed(ROOT / "docker/proxy/nginx.conf", changes), folder), {})


def caddy(folder: Path, certificate: tuple[Path, Path], port: int, behind: int, **more: str) -> Started:
    return _caddy(folder, f"{certificate[0]} {certificate[1]}", port, behind, **more)


def caddy_with_an_authority_of_its_own(
    folder: Path, _: tuple[Path, Path], port: int, behind: int, **more: str
) -> Started:
    """As in docker/compose.yaml."""
    return _caddy(folder, "internal", port, behind, **more)


def _caddy(folder: Path, made_by: str, port: int, behind: int, **more: str) -> Started:
    changes = {"\tskip_install_trust": OWN_CADDY, **more}
    (folder / "Caddyfile").write_text(changed(ROOT / "docker/proxy/Caddyfile", changes))
    env = {
        "HTTPS_NAME": f"{HOST}:{port}",
        "HTTPS_CERTIFICATE": made_by,
        "HTTPS_UPSTREAM": f"127.0.0.1:{behind}",
    }
    if made_by == "internal":
        env["SSL_CERT_FILE"] = str(folder / "caddy/pki/authorities/local/root.crt")
    return Started(["caddy", "run", "--config", f"{folder}/Caddyfile", "--adapter", "caddyfile"], env)


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
    with OwnServer(lanes=1, api_keys=KEY, ping_interval_s=0.5, max_sessions_per_lane=2 * STREAMS) as server:
        yield server


@contextmanager
def proxied(make: Callable[..., Started], certificate: tuple[Path, Path], behind: int, **changes: str) -> Iterator[str]:
    """A proxy before the port ``behind``: its URL."""
    program = make.__name__.partition("_")[0]
    require(shutil.which(program), f"no {program}")
    with tempfile.TemporaryDirectory() as made, pytest.MonkeyPatch.context() as environment:
        folder, port = Path(made), free_port()
        environment.setenv("SSL_CERT_FILE", str(certificate[0]))
        for name in ("HOME", "XDG_DATA_HOME", "XDG_CONFIG_HOME"):
            environment.setenv(name, str(folder))
        started = make(folder, certificate, port, behind, **changes)
        for name, value in started.env.items():
            environment.setenv(name, value)
        with running(started.command, folder, lambda: answers(port)):
            yield f"https://{HOST}:{port}"


PROXIES = pytest.mark.parametrize("make", [nginx, caddy], ids=["nginx", "caddy"])


@pytest.fixture(params=[nginx, caddy, caddy_with_an_authority_of_its_own], ids=["nginx", "caddy", "caddy-authority"])
def proxy(request: pytest.FixtureRequest, certificate: tuple[Path, Path], behind: OwnServer) -> Iterator[Proxy]:
    with proxied(request.param, certificate, behind.port, **{"75s": "2s"}) as url:
        yield Proxy(url, behind)


def answers(port: int) -> bool:
    """Whether there is a proxy that has its certificate."""
    trusting = ssl.create_default_context()
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=5) as plain:
            trusting.wrap_socket(plain, server_hostname=HOST).close()
    except OSError:
        return False
    return True


@pytest.fixture(scope="module")
def clip() -> Clip:
    david = OTB_ROOT / "David"
    return open_clip(david, None, 40) if david.is_dir() else sample(40)


def test_calls_and_streams_give_the_same_results_through_a_proxy(proxy: Proxy, clip: Clip) -> None:
    runs = []
    for url in (proxy.server.url, proxy.url):
        with Client(url, key=KEY) as client:
            session = client.create(clip.frames[0], box=clip.box)
            assert session.info.stream_url.startswith(url.replace("http", "ws", 1))
            first = session.track(clip.frames[1])
            results = [first, *session.stream(clip.frames[2:], mode="lossless")]
            session.close()
        runs.append([(result.seq, [target.box for target in result.targets]) for result in results])
    assert runs[0] == runs[1]
    assert len(runs[1]) == len(clip.frames) - 1


async def test_pings_keep_a_quiet_stream_open(proxy: Proxy, clip: Clip) -> None:
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


def test_large_frames_pass_and_the_service_refuses_larger_ones(proxy: Proxy, clip: Clip) -> None:
    with httpx2.Client(base_url=proxy.url, verify=context(), headers={"X-API-Key": KEY}, timeout=30) as http:
        made = http.post("/v1/sessions", files={"frame": clip.frames[0]}, data={"box": ",".join(map(str, clip.box))})
        assert made.status_code == 201, made.text
        path = f"{made.headers['location']}/frames"
        headers = {"Content-Type": "image/jpeg"}
        # a JPEG may be followed by anything
        large = http.post(path, content=clip.frames[1] + bytes(6_000_000), headers=headers)
        assert large.status_code == 200, large.text
        above = http.post(path, content=clip.frames[1] + bytes(9_000_000), headers=headers)
        assert (above.status_code, above.json()["code"]) == (413, "frame-too-large")


def test_metrics_are_not_reachable_from_outside(proxy: Proxy) -> None:
    with httpx2.Client(base_url=proxy.url, verify=context()) as http:
        assert http.get("/livez").status_code == 200
        assert http.get("/metrics").status_code == 404


@PROXIES
async def test_a_hundred_streams_pass(
    make: Callable[..., Started], certificate: tuple[Path, Path], behind: OwnServer, clip: Clip
) -> None:
    with proxied(make, certificate, behind.port) as url:
        async with AsyncClient(url, key=KEY) as client:
            attached = asyncio.Event()
            streams = 0

            async def one() -> int:
                session = await client.create(clip.frames[0], box=clip.box)

                async def frames() -> AsyncIterator[bytes]:
                    nonlocal streams
                    yield clip.frames[1]
                    streams += 1
                    if streams == STREAMS:
                        attached.set()
                    await attached.wait()  # all of them are open at once
                    yield clip.frames[2]

                seen = [result.seq async for result in session.stream(frames(), mode="lossless")]
                await session.close()
                return len(seen)

            assert await asyncio.gather(*(one() for _ in range(STREAMS))) == [2] * STREAMS


@PROXIES
def test_a_missing_service_is_answered_with_a_problem(
    make: Callable[..., Started], certificate: tuple[Path, Path]
) -> None:
    with proxied(make, certificate, free_port()) as url, httpx2.Client(base_url=url, verify=context()) as client:
        answer = client.get("/v1/sessions")
    assert_problem(answer, 503, "draining")
    assert answer.headers["retry-after"] == "1"


def test_too_many_calls_of_one_address_are_answered_with_a_problem(
    certificate: tuple[Path, Path], behind: OwnServer
) -> None:
    tight = {"rate=50r/s": "rate=1r/m", "burst=500 nodelay": "burst=2 nodelay"}
    with (
        proxied(nginx, certificate, behind.port, **tight) as url,
        httpx2.Client(base_url=url, verify=context()) as client,
    ):
        answers = [client.get("/livez") for _ in range(4)]
        assert [answer.status_code for answer in answers] == [200, 200, 200, 429]
        assert_problem(answers[-1], 429, "rate-limited")
        assert answers[-1].headers["retry-after"] == "1"
        # who shows a key is not counted among strangers
        assert client.get("/v1/sessions", headers={"X-API-Key": KEY}).status_code == 200


def test_a_body_above_nginx_s_limit_is_answered_with_a_problem(
    certificate: tuple[Path, Path], behind: OwnServer
) -> None:
    with proxied(nginx, certificate, behind.port) as url:
        call = http.client.HTTPSConnection(url.removeprefix("https://"), timeout=30, context=context(certificate[0]))
        call.request("POST", "/v1/sessions", headers={"Content-Length": "70000000", "X-API-Key": KEY})
        answer = call.getresponse()
        assert answer.status == 413
        assert json.loads(answer.read())["code"] == "body-too-large"
        call.close()


def context(authority: Path | None = None) -> ssl.SSLContext:
    """What trusts the proxy of now."""
    return ssl.create_default_context(cafile=authority or os.environ["SSL_CERT_FILE"])


def assert_problem(answer: httpx2.Response, status: int, code: str) -> None:
    assert answer.status_code == status
    assert answer.headers["content-type"] == MEDIA_TYPE
    problem = answer.json()
    kind = CATALOGUE[code]
    assert (problem["code"], problem["status"], problem["title"]) == (code, kind.status, kind.title)
