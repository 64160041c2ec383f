"""Both contracts as one page of plain HTML, without scripts and without files of other hosts."""

from __future__ import annotations

import json
from collections.abc import Iterator
from html import escape
from typing import Any

from ..protocol import examples
from ..protocol.problems import CATALOGUE
from .asyncapi import close_codes

STYLE = """
body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:0 auto;padding:1rem;color:#1b1f24;background:#fff}
h1,h2,h3{line-height:1.2}h2{margin-top:3rem;border-bottom:1px solid #d0d7de}
code,pre{font:14px/1.45 ui-monospace,monospace}pre{background:#f6f8fa;padding:.7rem;overflow:auto;border-radius:6px}
table{border-collapse:collapse;width:100%}td,th{text-align:left;padding:.3rem .6rem;border-bottom:1px solid #d0d7de;
vertical-align:top}details{margin:.5rem 0}summary{cursor:pointer}.method{font-weight:700;color:#0550ae}
a{color:#0550ae}:target{background:#fff8c5}
@media(prefers-color-scheme:dark){body{color:#e6edf3;background:#0d1117}pre{background:#161b22}a,.method{color:#79c0ff}
td,th,h2{border-color:#30363d}:target{background:#3b2e00}}
"""


def render(openapi: dict[str, Any], asyncapi: dict[str, Any]) -> str:
    """Return the page."""
    body = "".join(
        (
            *_head(openapi),
            *_calls(openapi),
            *_messages(asyncapi),
            *_problems(),
            *_closes(),
            *_schemas(openapi, asyncapi),
        )
    )
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>MFCMT</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<style>{STYLE}</style></head><body>{body}</body></html>"
    )


def _head(openapi: dict[str, Any]) -> Iterator[str]:
    info = openapi["info"]
    yield f"<h1>{escape(info['title'])} {escape(info['version'])}</h1><p>{escape(info['description'])}</p>"
    yield (
        '<p>Machine-readable: <a href="openapi.json">OpenAPI</a>, <a href="asyncapi.json">AsyncAPI</a>. Here: '
        '<a href="#calls">calls</a>, <a href="#stream">stream</a>, <a href="#problems">problems</a>, '
        '<a href="#closes">close codes</a>, <a href="#schemas">schemas</a>.</p>'
    )


def _calls(openapi: dict[str, Any]) -> Iterator[str]:
    yield '<h2 id="calls">HTTP calls</h2>'
    for path, calls in openapi["paths"].items():
        for method, call in calls.items():
            yield f'<h3><span class="method">{method.upper()}</span> <code>{escape(path)}</code></h3>'
            yield f"<p>{_text(call.get('description', ''))}</p>"
            if parameters := call.get("parameters"):
                yield "<table><tr><th>parameter</th><th>in</th><th></th></tr>"
                for one in parameters:
                    name = f"<code>{escape(one['name'])}</code>{' *' if one.get('required') else ''}"
                    yield f"<tr><td>{name}</td><td>{one['in']}</td><td>{_text(one.get('description', ''))}</td></tr>"
                yield "</table>"
            if body := call.get("requestBody"):
                yield from _contents("body", body["content"])
            for status, answer in call["responses"].items():
                yield f"<p><b>{status}</b> {_text(answer['description'])}</p>"
                if not status.startswith(("4", "5")):
                    yield from _contents("answer", answer.get("content", {}))


def _contents(what: str, contents: dict[str, Any]) -> Iterator[str]:
    for kind, media in contents.items():
        shown = [media["example"]] if "example" in media else [e["value"] for e in media.get("examples", {}).values()]
        yield f"<details><summary>{what} <code>{escape(kind)}</code></summary>"
        yield "".join(_pre(one) for one in shown)
        yield f"{_pre(media['schema'])}</details>"


def _messages(asyncapi: dict[str, Any]) -> Iterator[str]:
    yield f'<h2 id="stream">Stream</h2><p>{_text(asyncapi["info"]["description"])}</p>'
    for operation in asyncapi["operations"].values():
        yield f"<h3>{escape(operation['title'])}</h3>"
        for ref in operation["messages"]:
            message = asyncapi["components"]["messages"][ref["$ref"].rpartition("/")[2]]
            yield f"<details><summary><code>{message['name']}</code> {_text(message['summary'])}</summary>"
            yield "".join(_pre(example["payload"]) for example in message["examples"])
            yield "</details>"


def _problems() -> Iterator[str]:
    yield '<h2 id="problems">Problems</h2>'
    for code, kind in CATALOGUE.items():
        yield f'<h3 id="{code}"><code>{code}</code> {kind.status}</h3><p>{_text(kind.title)}.</p>'
        yield _pre(examples.problem(code))


def _closes() -> Iterator[str]:
    yield '<h2 id="closes">Close codes</h2><table>'
    for code, text in close_codes().items():
        yield f"<tr><td>{code}</td><td>{_text(text)}</td></tr>"
    yield "</table>"


def _schemas(openapi: dict[str, Any], asyncapi: dict[str, Any]) -> Iterator[str]:
    yield '<h2 id="schemas">Schemas</h2>'
    schemas = asyncapi["components"]["schemas"] | openapi["components"]["schemas"]
    for name, schema in sorted(schemas.items()):
        yield f'<details id="schema-{name}"><summary><code>{name}</code></summary>{_pre(schema)}</details>'


def _pre(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, indent=2)
    return f"<pre>{escape(text)}</pre>"


def _text(text: str) -> str:
    """Return ``text`` escaped, with `code` as code."""
    pieces = escape(text).split("`")
    return "".join(f"<code>{piece}</code>" if odd % 2 else piece for odd, piece in enumerate(pieces))
