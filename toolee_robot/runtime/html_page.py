"""A self-contained HTML page: headings and tables; nothing is fetched."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from jinja2 import Environment, PackageLoader
from markupsafe import Markup, escape


class Page:
    """Builder of a page; `text` returns it.

    Args:
        title: Title of the page.
        subtitle: Line below it.
    """

    def __init__(self, title: str, subtitle: str) -> None:
        self._title, self._subtitle = title, subtitle
        self._parts: list[tuple[str, dict[str, Any]]] = []

    def section(self, title: str) -> None:
        """Add a section, listed in the table of contents."""
        self._add("section", title=title)

    def heading(self, title: str) -> None:
        """Add a heading within a section."""
        self._add("heading", title=title)

    def paragraph(self, text: str) -> None:
        """Add plain text."""
        self._add("paragraph", text=text)

    def cards(self, values: Sequence[tuple[str, str]]) -> None:
        """Add large figures, each a value and its description."""
        self._add("cards", values=values)

    def table(self, head: Sequence[str], rows: Sequence[Sequence[Any]], left: int = 1) -> None:
        """Add a table.

        Args:
            head: Column headings.
            rows: Cells, each a string or a pair (string, whether it is the best).
            left: Number of left-aligned columns of text.
        """
        self._add("table", head=head, rows=rows, left=left)

    def definitions(self, entries: dict[str, str]) -> None:
        """Add a list of terms."""
        self._add("definitions", entries=entries)

    def text(self) -> str:
        """The whole page."""
        environment = Environment(loader=PackageLoader(__package__, "."), autoescape=True)
        environment.filters |= {"anchor": _anchor, "with_unit": _with_unit, "whole_options": _whole_options}
        template = environment.get_template("page.html")
        return template.render(title=self._title, subtitle=self._subtitle, parts=self._parts) + "\n"

    def _add(self, kind: str, **part: Any) -> None:
        self._parts.append((kind, part))


def _anchor(title: str) -> str:
    return "-".join("".join(c if c.isalnum() else " " for c in title.lower()).split())


def _whole_options(text: str) -> Markup:
    """Keep a command's options from being broken after their dashes."""
    return Markup(re.sub(r"(?<= )--\S+", r"<span>\g<0></span>", str(escape(text))))


def _with_unit(text: str) -> str:
    """A column heading that may wrap, but not between a number and its unit."""
    return re.sub(r" (?=(cm|mm|%|°)( |$))", "\u00a0", text)
