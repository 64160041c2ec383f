"""A page of headings, paragraphs, tables and figures, as Markdown and as one self-contained HTML file."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable
from collections.abc import Sequence as Seq
from dataclasses import dataclass

PALETTE = ("#d62728", "#1f77b4", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#e377c2", "#8c564b", "#7f7f7f")
"""Colours of the trackers, in plots and films."""

MEDIA_TYPES = {"svg": "image/svg+xml", "jpg": "image/jpeg"}


class Strong(str):
    """A cell that stands out."""


@dataclass(frozen=True)
class Heading:
    """A title; ``level`` 1 is the page's."""

    text: str
    level: int = 2


@dataclass(frozen=True)
class Table:
    """Rows of text; the first column is the name of the row."""

    header: Seq[str]
    rows: Seq[Seq[str]]


@dataclass(frozen=True)
class Picture:
    """A figure; ``suffix`` is ``svg`` or ``jpg``."""

    name: str
    title: str
    data: bytes
    suffix: str = "svg"

    @property
    def file(self) -> str:
        """Return the name of its file."""
        return f"{self.name}.{self.suffix}"


Block = Heading | Table | Picture | str


def to_markdown(blocks: Iterable[Block]) -> str:
    """Return the blocks as Markdown; pictures are linked by their file names."""
    return "\n\n".join(_markdown(b) for b in blocks) + "\n"


def to_html(title: str, blocks: Iterable[Block]) -> str:
    """Return the blocks as one HTML file with its pictures in it."""
    return _PAGE.format(title=html.escape(title), body="\n".join(_html(b) for b in blocks))


def _markdown(block: Block) -> str:
    match block:
        case Heading():
            return "#" * block.level + " " + block.text
        case Table():
            lines = [block.header, ["---"] * len(block.header), *block.rows]
            return "\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines)
        case Picture():
            return f"![{block.title}]({block.file})"
        case _:
            return block


def _cell(text: str) -> str:
    escaped = text.replace("|", "\\|")
    return f"**{escaped}**" if isinstance(text, Strong) else escaped


def _html(block: Block) -> str:
    match block:
        case Heading():
            return f"<h{block.level}>{html.escape(block.text)}</h{block.level}>"
        case Table():
            head = "".join(f"<th>{html.escape(h)}</th>" for h in block.header)
            body = "\n".join("<tr>" + "".join(map(_html_cell, row)) + "</tr>" for row in block.rows)
            return f"<div><table><thead><tr>{head}</tr></thead><tbody>\n{body}\n</tbody></table></div>"
        case Picture():
            source = f"data:{MEDIA_TYPES[block.suffix]};base64,{base64.b64encode(block.data).decode()}"
            return f'<img alt="{html.escape(block.title)}" src="{source}">'
        case _:
            return f"<p>{html.escape(block)}</p>"


def _html_cell(text: str) -> str:
    escaped = html.escape(text)
    return f"<td><b>{escaped}</b></td>" if isinstance(text, Strong) else f"<td>{escaped}</td>"


_PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
:root {{ color-scheme: light dark }}
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem }}
div {{ overflow-x: auto }}
table {{ border-collapse: collapse; margin: 1rem 0; font-variant-numeric: tabular-nums }}
th, td {{ padding: .2rem .7rem; border-bottom: 1px solid #8884; text-align: right; white-space: nowrap }}
th:first-child, td:first-child {{ text-align: left }}
img {{ max-width: 100%; background: #fff; border-radius: 4px; margin: .5rem 0 }}
</style>
{body}
</html>
"""
