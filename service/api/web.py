"""The page at ``/`` and its files. They are read once, so that no other file can be reached."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import tarfile
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable

from fastapi import APIRouter
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

router = APIRouter(include_in_schema=False)
FOLDERS = ("page", "client")
PACKAGE = "mfcmt-client.tgz"
"""The JavaScript client as npm packs it, below ``/static/``: ``npm install URL`` takes it."""
KINDS = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".jpg": "image/jpeg",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".mjs": "text/javascript; charset=utf-8",
    ".png": "image/png",
    ".svg": "image/svg+xml; charset=utf-8",
    ".tgz": "application/gzip",
    ".ts": "text/plain; charset=utf-8",
    ".webm": "video/webm",
    ".webmanifest": "application/manifest+json",
}
"""Media types by suffix; files with other suffixes are not served."""
PAGE_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        "media-src 'self' blob:; connect-src 'self'; worker-src 'self'; manifest-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Permissions-Policy": "camera=(self), microphone=(), geolocation=()",
}


@dataclass(frozen=True, slots=True)
class Asset:
    """One file as it is sent."""

    body: bytes
    kind: str
    etag: str

    @classmethod
    def of(cls, body: bytes, suffix: str) -> Asset:
        """Return the file with the content ``body``; ``suffix`` is one of :data:`KINDS`."""
        return cls(body, KINDS[suffix], f'"{hashlib.sha256(body).hexdigest()[:32]}"')


def load() -> dict[str, Asset]:
    """Return all files of the page and the JavaScript client, by their path below ``/static/``."""
    web = files("service").joinpath("web")
    assets: dict[str, Asset] = {}
    for folder in FOLDERS:
        _collect(web.joinpath(folder), folder, assets)
    assets[PACKAGE] = Asset.of(packed(web.joinpath("client")), ".tgz")
    return assets


def packed(folder: Traversable) -> bytes:
    """Return the npm package in ``folder`` as ``npm pack`` makes it, the same bytes each time."""
    manifest = json.loads(folder.joinpath("package.json").read_text(encoding="utf-8"))
    data = io.BytesIO()
    with gzip.GzipFile(fileobj=data, mode="wb", mtime=0) as zipped, tarfile.open(fileobj=zipped, mode="w") as tar:
        for name in sorted({"package.json", "README.md", *manifest["files"]}):
            _add(tar, folder.joinpath(name), f"package/{name}")
    return data.getvalue()


@router.get("/")
async def page(request: Request) -> Response:
    """Return the web page."""
    return _answer(request, "page/index.html", PAGE_HEADERS)


@router.get("/static/{path:path}")
async def static(request: Request, path: str) -> Response:
    """Return a file of the page or of the JavaScript client."""
    return _answer(request, path, {})


def _add(tar: tarfile.TarFile, entry: Traversable, path: str) -> None:
    if entry.is_dir():
        for child in sorted(entry.iterdir(), key=lambda child: child.name):
            _add(tar, child, f"{path}/{child.name}")
        return
    body = entry.read_bytes()
    info = tarfile.TarInfo(path)
    info.size, info.mode = len(body), 0o644
    tar.addfile(info, io.BytesIO(body))


def _collect(folder: Traversable, path: str, assets: dict[str, Asset]) -> None:
    if not folder.is_dir():
        return
    for entry in folder.iterdir():
        suffix = entry.name[entry.name.rfind(".") :]
        if entry.is_dir():
            if entry.name not in ("node_modules", "__pycache__"):
                _collect(entry, f"{path}/{entry.name}", assets)
        elif suffix in KINDS:
            assets[f"{path}/{entry.name}"] = Asset.of(entry.read_bytes(), suffix)


def _answer(request: Request, path: str, extra: dict[str, str]) -> Response:
    asset: Asset | None = request.app.state.assets.get(path)
    if asset is None:
        raise HTTPException(404)
    # Browsers ask each time and mostly get 304, so that the next reload shows a new version.
    headers = {"ETag": asset.etag, "Cache-Control": "no-cache", "Content-Type": asset.kind} | extra
    if asset.etag in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    return Response(asset.body, headers=headers)
