"""Videos that another tool names: fetched from allowed hosts alone, read frame by frame in a process without rights."""

from __future__ import annotations

import asyncio
import logging
import math
import sys
import tempfile
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from http.cookiejar import CookieJar, DefaultCookiePolicy
from pathlib import Path
from urllib.parse import urljoin, urlsplit

import httpx2

from ..protocol.enums import ProblemCode
from ..protocol.problems import ProblemError
from ..settings import Settings
from .video_frames import HEAD

# Its lines have the whole URL of each request, in which a storage's signature may be.
logging.getLogger("httpx2").setLevel(logging.WARNING)
MAX_REDIRECTS = 3
FETCH_S = 30.0
AS_IT_IS = {"Accept-Encoding": "identity"}  # what is sent packed could unpack to any size
PORTS = {"http": 80, "https": 443}


@dataclass(frozen=True, slots=True)
class VideoFrame:
    """A frame as JPEG: its number from 0, its time in seconds, its width and height in pixels."""

    index: int
    time_s: float
    size: tuple[int, int]
    jpeg: bytes


def make_client() -> httpx2.AsyncClient:
    """Return the client that fetches. It follows no redirection, keeps no cookie, and reads no variable for a proxy.

    It is made once, because to load its modules and certificates takes the event loop for long.
    """
    cookies = CookieJar(DefaultCookiePolicy(allowed_domains=[]))
    return httpx2.AsyncClient(follow_redirects=False, trust_env=False, cookies=cookies)


@asynccontextmanager
async def fetched(
    client: httpx2.AsyncClient, url: str, settings: Settings, headers_of: Callable[[str], dict[str, str]]
) -> AsyncIterator[Path]:
    """Yield a file with what is at ``url``, which is removed afterwards.

    ``headers_of`` returns the headers for a host, as ``host:port``: each hop of a redirection is asked anew, so that a
    token never goes to another host. Raises bad-request, body-too-large, deadline-exceeded.
    """
    with tempfile.TemporaryDirectory(prefix="mfcmt-video-") as folder, (Path(folder) / "video").open("wb") as file:
        try:
            async with asyncio.timeout(FETCH_S):
                for _ in range(1 + MAX_REDIRECTS):
                    host = _allowed(url, settings)
                    async with client.stream("GET", url, headers=AS_IT_IS | headers_of(host)) as answer:
                        if answer.is_redirect:
                            url = urljoin(url, answer.headers.get("location", ""))
                            continue
                        if answer.status_code != 200:
                            raise _bad(f"{host} answered with {answer.status_code} instead of the video")
                        size = 0
                        async for part in answer.aiter_raw(64 * 1024):
                            size += len(part)
                            if size > settings.max_video_bytes:
                                detail = f"a video has at most {settings.max_video_bytes} bytes"
                                raise ProblemError(ProblemCode.BODY_TOO_LARGE, detail)
                            file.write(part)
                        break
                else:
                    raise _bad("the video is behind too many redirections")
        except TimeoutError:
            raise ProblemError(ProblemCode.DEADLINE_EXCEEDED, "the video took too long to come") from None
        except httpx2.HTTPError as failed:
            raise _bad(f"the video cannot be fetched ({type(failed).__name__})") from None
        file.flush()
        yield Path(file.name)


async def frames(path: Path, first_s: float, settings: Settings) -> AsyncGenerator[VideoFrame, None]:
    """Yield the frames of a video file from the one at ``first_s`` seconds on. Raises bad-request."""
    program = (sys.executable, "-m", "service.bridges.video_frames", str(path), repr(first_s))
    limit = 2 * settings.max_frame_bytes
    child = await asyncio.create_subprocess_exec(
        *program, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    assert child.stdout is not None
    assert child.stderr is not None
    try:
        while head := await _exactly(child.stdout, HEAD.size):
            index, time_s, width, height, length = HEAD.unpack(head)
            if length > limit or width * height > settings.max_frame_pixels or not math.isfinite(time_s):
                raise _bad(f"the frames of the video are too large: at most {settings.max_frame_pixels} pixels")
            yield VideoFrame(index, time_s, (width, height), await child.stdout.readexactly(length))
        said = (await child.stderr.read(2000)).decode(errors="replace").strip()
        if await child.wait() != 0:
            raise _bad(said.splitlines()[-1] if said else "the video cannot be read")
    except asyncio.IncompleteReadError:
        raise _bad("the video cannot be read") from None
    finally:
        if child.returncode is None:
            child.kill()
            await child.wait()


async def _exactly(stream: asyncio.StreamReader, size: int) -> bytes:
    """Return ``size`` bytes, none at the end of the stream. Raises IncompleteReadError if it ends within them."""
    try:
        return await stream.readexactly(size)
    except asyncio.IncompleteReadError as ended:
        if ended.partial:
            raise
        return b""


def _allowed(url: str, settings: Settings) -> str:
    """Return ``host:port`` of a URL that may be fetched. Raises bad-request for any other."""
    try:
        parts = urlsplit(url)
        host, port = (parts.hostname or "").lower(), parts.port or PORTS.get(parts.scheme)
    except ValueError:
        host, port = "", None
    if not host or port is None or parts.scheme not in PORTS or parts.username or parts.password:
        raise _bad("a video is at an http or https URL without a password")
    if not {host, f"{host}:{port}"} & set(settings.video_hosts):
        detail = f"videos are not fetched from {host[:100]}:{port}; the operator can add it to MFCMT_VIDEO_HOSTS"
        raise _bad(detail)
    return f"{host}:{port}"


def _bad(detail: str) -> ProblemError:
    return ProblemError(ProblemCode.BAD_REQUEST, detail)
