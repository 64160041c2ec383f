"""Writes what is made from service/protocol: tables of docs/protocol.md and types of mfcmt.d.ts.

``make guide`` writes both; ``make lint`` runs this with ``--check``, which only says whether they are fresh.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from service.api.asyncapi import close_codes
from service.protocol import answers, capabilities, requests
from service.protocol.enums import ProblemCode
from service.protocol.problems import CATALOGUE
from service.protocol.target import Target

from . import typescript

DOCUMENT = Path(__file__).resolve().parents[2] / "docs/protocol.md"


def problems_table() -> str:
    """Return every problem: its code, status, and when it is used."""
    rows = ["| `code` | status | when |", "|---|---|---|"]
    rows += [f"| `{code}` | {CATALOGUE[code].status} | {CATALOGUE[code].when} |" for code in ProblemCode]
    return "\n".join(rows)


def closes_table() -> str:
    """Return every close code and what it says."""
    return "\n".join(
        ["| code | says |", "|---|---|", *(f"| {code} | {text} |" for code, text in close_codes().items())]
    )


def fields_table(kind: type) -> Callable[[], str]:
    """Return what makes the table of a message's fields that have a description."""

    def table() -> str:
        rows = (f"| `{one.name}` | {one.metadata.get('description', '')} |" for one in fields(kind))
        return "\n".join(["| field | meaning |", "|---|---|", *rows])

    return table


def messages_table(kinds: Iterable[type]) -> Callable[[], str]:
    """Return what makes the table of messages: fields that may be left out have a question mark."""

    def table() -> str:
        rows = ["| `type` | fields | |", "|---|---|---|"]
        for kind in kinds:
            sent: Any = kind
            names = ", ".join(f"`{one.name}{'?' if _optional(kind, one) else ''}`" for one in fields(sent))
            summary = (kind.__doc__ or "").partition("\n\n")[0].replace("\n    ", " ")
            rows.append(f"| `{sent.TYPE}` | {names} | {summary} |")
        return "\n".join(rows)

    return table


def _optional(kind: Any, one: Any) -> bool:
    sent = kind in requests.STREAM_MESSAGES and one.default is not MISSING
    return sent or one.name in getattr(kind, "OPTIONAL", ())


def limits_list() -> str:
    """Return the names of the limits that capabilities have."""
    return ", ".join(f"`{one.name}`" for one in fields(capabilities.Limits))


TABLES: dict[str, Callable[[], str]] = {
    "problems": problems_table,
    "closes": closes_table,
    "target": fields_table(Target),
    "options": fields_table(requests.Options),
    "client messages": messages_table(requests.STREAM_MESSAGES),
    "service messages": messages_table(answers.STREAM_MESSAGES),
    "limits": limits_list,
}


def fresh(text: str) -> str:
    """Return the text of the document with every table as it should be."""
    for name, table in TABLES.items():
        block = re.compile(rf"(<!-- table: {name} -->\n)(.*?)(<!-- end -->)", re.S)
        made = table()
        text = block.sub(lambda found, made=made: f"{found[1]}{made}\n{found[3]}", text)
    return text


MADE = {DOCUMENT: fresh, typescript.DECLARATIONS: typescript.fresh}


def main() -> int:
    """Write both files, or with ``--check`` say which is not fresh."""
    stale = []
    for path, make in MADE.items():
        there = path.read_text(encoding="utf-8")
        if (made := make(there)) == there:
            continue
        stale.append(path.name)
        if "--check" not in sys.argv:
            path.write_text(made, encoding="utf-8")
    if stale and "--check" in sys.argv:
        print(f"not made from service/protocol as it is: {', '.join(stale)}; run `make guide`")  # noqa: T201
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
