"""The language checker finds what it must and leaves code alone."""

from __future__ import annotations

import re

import pytest

from scripts.check_language import ROOT, Term, findings, load_terms

TERMS = [
    Term(re.compile(r"\bmagic box\b", re.IGNORECASE), "robot", documents_only=False),
    Term(re.compile(r"\bof yore\b", re.IGNORECASE), "what holds today", documents_only=True),
]


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("docs/a.md", "The Magic\nbox moves."),
        ("a.py", '"""Moves the magic box."""\n'),
        ("a.py", "x = 1  # the magic box\n"),
        ("a.py", 'print(f"{1} magic box moved")\n'),
        ("docs/a.md", "With the weights of yore it was less."),
    ],
)
def test_a_term_is_found_in_prose(path: str, text: str) -> None:
    assert len(list(findings(path, text, TERMS))) == 1


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("docs/a.md", "The field `magic box` and\n\n```\nmagic box\n```\n"),
        ("a.py", "magic_box = 'magicbox'\n"),
        ("docs/research_log.md", "With the weights of yore it was less."),
        ("a.py", '"""With the weights of yore."""\n'),
    ],
)
def test_code_and_history_are_left_alone(path: str, text: str) -> None:
    assert not list(findings(path, text, TERMS))


def test_a_finding_says_where_and_what_to_write() -> None:
    found = list(findings("docs/a.md", "One.\n\nTwo\nmagic box.", TERMS))
    assert found == ["docs/a.md:3: 'magic box': write robot"]


def test_the_projects_own_terms_load() -> None:
    assert len(load_terms(ROOT / "scripts/terms.toml")) > 10
