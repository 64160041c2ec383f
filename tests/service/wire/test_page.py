"""The page's files as they are served."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import pytest

import service
from service.api import web

from .conftest import Wire

ROOT = Path(service.__file__).parent / "web"


async def test_the_page_and_its_policy(wire: Wire) -> None:
    answer = await wire.http.get("/")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    policy = dict(part.strip().partition(" ")[::2] for part in answer.headers["content-security-policy"].split(";"))
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
    assert policy["frame-ancestors"] == "'none'"
    assert "unsafe" not in answer.headers["content-security-policy"]
    assert answer.headers["x-content-type-options"] == "nosniff"
    html = answer.text
    assert not re.search(r"<script(?![^>]*\bsrc=)|<style|\sstyle=|\son\w+=", html)
    assert not re.search(r"(?:src|href)=\"(?:https?:)?//", html)


def named(file: Path) -> set[Path]:
    """The files of the page that one of them names: by an import, or by an attribute."""
    text = file.read_text()
    if file.suffix == ".js":
        found = re.findall(r"""(?:from|import\(|new URL\()\s*["'](\.{1,2}/[^"'$]*\.\w+)["']""", text)
        return {(file.parent / one).resolve() for one in found}
    home = ROOT / "page" if file.suffix == ".webmanifest" else ROOT.parent
    found = re.findall(r"[\"'](\./[\w./-]+\.\w+)[\"']", text)
    return {Path(str(home / one).replace("service/static/", "service/web/")).resolve() for one in found}


async def test_every_file_that_is_named_is_there(wire: Wire) -> None:
    own = [file for file in (ROOT / "page").rglob("*.js") if "vendor" not in file.parts]
    files = [*own, *(ROOT / "page").glob("*.html"), *(ROOT / "page").glob("*.webmanifest")]
    wanted = {path.relative_to(ROOT) for file in files for path in named(file)}
    assert len(wanted) > 40
    for path in wanted:
        answer = await wire.http.get(f"/static/{path}")
        assert answer.status_code == 200, path
        assert answer.headers["content-type"] == web.KINDS[path.suffix]


def test_no_file_of_the_page_has_an_absolute_path() -> None:
    """So that a proxy may have the service at any path."""
    for file in (ROOT / "page").rglob("*"):
        if file.suffix in (".js", ".html", ".webmanifest", ".css") and "vendor" not in file.parts:
            assert not re.search(r"""["'(`]/(?:static|docs|v1|openapi)""", file.read_text()), file


def test_vendored_files_are_those_of_their_packages() -> None:
    vendor = ROOT / "page" / "vendor"
    sums = dict(
        line.split()[::-1] for line in re.findall(r"^[0-9a-f]{64} .*$", (vendor / "README.md").read_text(), re.M)
    )
    assert set(sums) == {str(path.relative_to(vendor)) for path in vendor.glob("*/*")}
    for name, digest in sums.items():
        assert hashlib.sha256((vendor / name).read_bytes()).hexdigest() == digest


async def test_a_file_is_sent_once(wire: Wire) -> None:
    first = await wire.http.get("/static/page/sample.webm")
    assert first.headers["content-type"] == "video/webm"
    assert first.headers["cache-control"] == "no-cache"
    again = await wire.http.get("/static/page/sample.webm", headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")


@pytest.mark.parametrize(
    "path",
    [
        "page",
        "page/",
        "page/../client/mfcmt.js",
        "page/%2e%2e/%2e%2e/app.py",
        "app.py",
        "page/none.js",
        "client/LICENSE",
    ],
)
async def test_nothing_else_is_reachable(wire: Wire, path: str) -> None:
    answer = await wire.http.get(f"/static/{path}")
    if answer.status_code == 200:  # the client has resolved the dots
        assert answer.request.url.path == "/static/client/mfcmt.js"
        return
    assert (answer.status_code, answer.json()["code"]) == (404, "not-found")


async def test_the_page_needs_no_key_and_posts_are_refused(serve: object, wire: Wire) -> None:
    answer = await wire.http.post("/")
    assert (answer.status_code, answer.json()["code"]) == (405, "method-not-allowed")
