"""The page's files as they are served."""

from __future__ import annotations

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


async def test_every_file_that_is_named_is_there(wire: Wire) -> None:
    files = [*(ROOT / "page").rglob("*.js"), *(ROOT / "page").glob("*.html"), *(ROOT / "page").glob("*.webmanifest")]
    named = {ref for file in files for ref in re.findall(r"[\"'`](/static/[\w./-]+\.\w+)", file.read_text())}
    named |= {
        f"/static/page/{n}" for f in files if f.suffix == ".js" for n in re.findall(r'from "\./(.+?)"', f.read_text())
    }
    assert len(named) > 20
    for path in named:
        answer = await wire.http.get(path)
        assert answer.status_code == 200, path
        assert answer.headers["content-type"] == web.KINDS[path[path.rindex(".") :]]


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
