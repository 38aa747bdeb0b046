"""The language checker finds what it must and leaves code alone."""

from __future__ import annotations

import re

import pytest

from scripts.check_language import Term, findings, long_sentences, mean_sentence, too_long

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


LIMITS: dict[str, float] = {"sentence": 6, "mean": 5, "page": 20, "site": 30}
LONG = "One two three four five six seven."


@pytest.mark.parametrize(
    "text",
    [
        LONG,
        "- One two three\n  four five\n  six seven.",
        "| a | b |\n|---|---|\n| c | One two three four five six seven |",
        "One two `three` [four five](http://a.b) six, e.g. Seven.",
    ],
)
def test_a_long_sentence_is_counted(text: str) -> None:
    assert len(long_sentences(f"# A heading of more words than a sentence may have\n\n{text}", 6)) == 1


@pytest.mark.parametrize(
    "text",
    [
        "One two three. Four five six? `Seven` eight.",
        "- One two three four\n- five six seven",
        "```\none two three four five six seven\n```",
        "<!-- one two three four five six seven -->",
        "[One](http://a.b/two-three) two 0.5 mm three.",
    ],
)
def test_short_sentences_and_code_are_not(text: str) -> None:
    assert not long_sentences(text, 6)


def test_the_mean_leaves_tables_out() -> None:
    assert mean_sentence("One two three four.\n\n| a |\n|---|\n| b |\n\nOne two.") == 3.0


def test_each_limit_has_a_finding() -> None:
    words = "One two three. " * 7
    found = list(too_long({"README.md": LONG, "docs/a.md": words, "docs/b.md": words}, LIMITS))
    assert [line.split(";")[0] for line in found] == [
        "README.md: 7 words a sentence in the mean",
        "README.md:1: 7 words",
        "docs/a.md: 21 words",
        "docs/b.md: 21 words",
        "docs: 42 words",
    ]
