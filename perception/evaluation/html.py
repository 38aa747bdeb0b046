"""A self-contained HTML page: headings, tables, embedded pictures; nothing is fetched."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from html import escape
from typing import Any

_STYLE = """
:root { --ink: #22303c; --soft: #5c6b78; --line: #dde3e8; --accent: #12609e; --tint: #f4f7f9; }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: #fff;
  font: 15px/1.55 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
header { background: var(--ink); color: #fff; padding: 34px 0 28px; }
header h1 { margin: 0 0 6px; font-size: 27px; font-weight: 650; letter-spacing: -.01em; }
header p { margin: 0; color: #c3ced7; max-width: none; }
header span { white-space: nowrap; }
header, main { padding-left: max(24px, calc(50vw - 540px)); padding-right: max(24px, calc(50vw - 540px)); }
main { padding-top: 18px; padding-bottom: 60px; }
h2 { margin: 42px 0 10px; padding-bottom: 6px; border-bottom: 2px solid var(--accent); font-size: 20px; }
h3 { margin: 28px 0 8px; font-size: 16px; }
p { max-width: 820px; }
nav { margin: 14px 0 0; color: var(--soft); font-size: 14px; }
nav a { display: inline-block; color: var(--accent); text-decoration: none; margin-right: 16px; }
.cards { display: flex; flex-wrap: wrap; gap: 12px; margin: 18px 0; }
.card { flex: 1 1 170px; padding: 12px 16px; background: var(--tint); border: 1px solid var(--line);
  border-radius: 8px; }
.card b { display: block; font-size: 24px; font-weight: 650; font-variant-numeric: tabular-nums; }
.card span { color: var(--soft); font-size: 13px; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; margin: 8px 0 18px; font-size: 13.5px; font-variant-numeric: tabular-nums; }
th, td { padding: 5px 11px; text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap; }
th { background: var(--tint); color: var(--soft); font-weight: 600; line-height: 1.3; vertical-align: bottom;
  white-space: normal; }
th:first-child, td:first-child, th.left, td.left { text-align: left; }
tr.first td { border-top: 2px solid var(--line); }
tr.total td { background: var(--tint); }
td.best { font-weight: 700; color: var(--accent); }
figure { margin: 14px 0 26px; }
img { max-width: 100%; height: auto; padding: 12px; border: 1px solid var(--line); border-radius: 6px; }
figcaption, .note { color: var(--soft); font-size: 13.5px; max-width: 820px; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 4px 18px; font-size: 14px; max-width: 900px; }
dt { font-weight: 600; } dd { margin: 0; color: var(--soft); }
@media print { header { color: var(--ink); background: #fff; } header p { color: var(--soft); } }
"""


class Page:
    """Builder of a page; `text` returns it.

    Args:
        title: Title of the page.
        subtitle: Line below it.
    """

    def __init__(self, title: str, subtitle: str) -> None:
        self._title, self._subtitle = title, subtitle
        self._parts: list[str] = []
        self._sections: list[tuple[str, str]] = []

    def section(self, title: str) -> None:
        """Add a section, listed in the table of contents."""
        name = "-".join("".join(c if c.isalnum() else " " for c in title.lower()).split())
        self._sections.append((name, title))
        self._parts.append(f'<h2 id="{name}">{escape(title)}</h2>')

    def heading(self, title: str) -> None:
        """Add a heading within a section."""
        self._parts.append(f"<h3>{escape(title)}</h3>")

    def paragraph(self, text: str) -> None:
        """Add plain text."""
        self._parts.append(f"<p>{escape(text)}</p>")

    def cards(self, values: Sequence[tuple[str, str]]) -> None:
        """Add large figures, each a value and its description."""
        cards = "".join(f'<div class="card"><b>{escape(v)}</b><span>{escape(t)}</span></div>' for v, t in values)
        self._parts.append(f'<div class="cards">{cards}</div>')

    def table(
        self, head: Sequence[str], rows: Sequence[Sequence[Any]], starts: set[int] | None = None, left: int = 1
    ) -> None:
        """Add a table.

        Args:
            head: Column headings.
            rows: Cells, each a string or a pair (string, whether it is the best).
            starts: Rows with a rule above them.
            left: Number of left-aligned columns of text.
        """
        starts = starts or set()
        columns = "".join(
            f'<th class="left">{_heading(h)}</th>' if i < left else f"<th>{_heading(h)}</th>"
            for i, h in enumerate(head)
        )
        lines = []
        for number, row in enumerate(rows):
            cells = []
            for i, cell in enumerate(row):
                value, best = cell if isinstance(cell, tuple) else (cell, False)
                kind = ' class="best"' if best else ' class="left"' if i < left else ""
                cells.append(f"<td{kind}>{escape(str(value))}</td>")
            lines.append(f"<tr{' class=first' if number in starts else ''}>{''.join(cells)}</tr>")
        body = "".join(lines)
        self._parts.append(
            f'<div class="wide"><table><thead><tr>{columns}</tr></thead><tbody>{body}</tbody></table></div>'
        )

    def picture(self, png: bytes, caption: str) -> None:
        """Embed a picture.

        Args:
            png: Content of a PNG file.
            caption: Text below it.
        """
        data = base64.b64encode(png).decode()
        text = escape(caption)
        self._parts.append(
            f'<figure><img alt="{text}" src="data:image/png;base64,{data}"><figcaption>{text}</figcaption></figure>'
        )

    def definitions(self, entries: dict[str, str]) -> None:
        """Add a list of terms."""
        body = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in entries.items())
        self._parts.append(f"<dl>{body}</dl>")

    def text(self) -> str:
        """The whole page."""
        links = "".join(f'<a href="#{name}">{escape(title)}</a>' for name, title in self._sections)
        body = "\n".join(self._parts)
        return (
            f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            f'<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{escape(self._title)}</title><style>{_STYLE}</style></head>\n"
            f"<body><header><h1>{escape(self._title)}</h1><p>{_whole_options(self._subtitle)}</p></header>\n"
            f"<main><nav>{links}</nav>\n{body}\n</main></body></html>\n"
        )


def _whole_options(text: str) -> str:
    """Keep a command's options from being broken after their dashes."""
    return re.sub(r"(?<= )--\S+", r"<span>\g<0></span>", escape(text))


def _heading(text: str) -> str:
    """A column heading that may wrap, but not between a number and its unit."""
    return re.sub(r" (?=(cm|mm|%|°)( |$))", "\u00a0", escape(text))
