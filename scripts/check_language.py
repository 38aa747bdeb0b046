"""Spelling, terms and length: codespell, the terms of `terms.toml`, and its limits on sentences and pages.

Terms hold for Markdown outside of code, and for docstrings, comments and strings with spaces of Python files.
Lengths hold for the documents.
Exit code 1: something was found, one line each. Example: `python scripts/check_language.py`
"""

from __future__ import annotations

import io
import re
import subprocess
import sys
import tokenize
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
HISTORY = ("docs/research_log.md", "CHANGELOG.md")
"""Documents that tell what was."""
CODE = re.compile(r"^ *```.*?^ *```|`[^`\n]*`", re.MULTILINE | re.DOTALL)

PAGE = re.compile(r"(README|CONTRIBUTING|CHANGELOG|docs/.*)\.md$")
"""Documents that have limits; the history has none."""
ITEM = r"([-*+]|\d+\.) "
SITE = "docs"
"""Folder of the site."""
NO_PROSE = re.compile(r"<!--(?:[^-]|-(?!->))*-->|^--8<--.*$|^:::.*\n(?: +.*\n)*", re.MULTILINE)
"""Comments, included files, and entries that mkdocstrings writes."""
SENTENCE_END = re.compile(r"(?<!e\.g\.)(?<!i\.e\.)(?<!Fig\.)(?<=[.!?])[\"')*_]*\s+(?=[\"'(*_]*[A-Z0-9])")


@dataclass(frozen=True)
class Term:
    """A term that is not to be used."""

    pattern: re.Pattern[str]
    """What must not occur."""
    use: str
    """What to write instead."""
    documents_only: bool
    """Whether it may stand in Python files and in HISTORY."""

    def forbidden_in(self, path: str) -> bool:
        """Whether the rule holds for a file, given by its path in the repository."""
        return not self.documents_only or (path.endswith(".md") and path not in HISTORY)


def load_terms(path: Path) -> list[Term]:
    """Read the list of terms."""
    entries = tomllib.loads(path.read_text())["term"]
    return [Term(re.compile(e["pattern"], re.IGNORECASE), e["use"], e.get("only") == "documents") for e in entries]


def prose(path: str, text: str) -> Iterator[tuple[int, str]]:
    """Pieces of prose in a file: docstrings, comments and strings with spaces; in Markdown what is no code.

    Args:
        path: Path of the file, which tells its kind.
        text: Its content.

    Yields:
        Line number and text; whitespace within a piece is single spaces.
    """
    if path.endswith(".py"):
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            is_text = token.type in (tokenize.STRING, tokenize.COMMENT) or token.type == _FSTRING_MIDDLE
            if is_text and " " in token.string:
                yield token.start[0], " ".join(token.string.split())
        return
    blank = CODE.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), text)
    line = 1
    for paragraph in re.split(r"(\n{2,})", blank):
        yield line, " ".join(paragraph.split())
        line += paragraph.count("\n")


_FSTRING_MIDDLE = getattr(tokenize, "FSTRING_MIDDLE", None)
"""A token of its own from Python 3.12 on."""


def findings(path: str, text: str, terms: list[Term]) -> Iterator[str]:
    """Terms in a file that are not to be used.

    Args:
        path: Path of the file in the repository.
        text: Its content.
        terms: The list of terms.

    Yields:
        One line each: path, line number, what was found and what to write.
    """
    rules = [term for term in terms if term.forbidden_in(path)]
    for line, piece in prose(path, text):
        for term in rules:
            for match in term.pattern.finditer(piece):
                yield f"{path}:{line}: {match[0]!r}: write {term.use}"


def sentences(text: str) -> Iterator[tuple[int, str, bool]]:
    """Line number and text of each sentence of a Markdown page, and whether it stands in a table."""
    text = NO_PROSE.sub(lambda m: "\n" * m[0].count("\n"), text)
    text = CODE.sub(lambda m: "\n" * m[0].count("\n") if m[0].lstrip().startswith("```") else "Code", text)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)|<[^>\n]+>", r"\1", text)
    blocks: list[tuple[int, str, bool]] = []
    new = True
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        if not line or line.startswith(("#", "!!!", "???")):
            new = True
        elif line.startswith("|"):
            blocks.extend((number, cell.strip(), True) for cell in line.strip("|").split("|"))
            new = True
        elif new or re.match(ITEM, line):
            blocks.append((number, line, False))
            new = False
        else:
            blocks[-1] = (blocks[-1][0], f"{blocks[-1][1]} {line}", False)
    for number, block, in_table in blocks:
        for sentence in SENTENCE_END.split(re.sub(rf"^{ITEM}", "", block)):
            if words_of(sentence):
                yield number, sentence, in_table


def words_of(text: str) -> int:
    """Words of a text: what holds a letter or a digit."""
    return sum(any(letter.isalnum() for letter in word) for word in text.split())


def long_sentences(text: str, limit: int) -> list[tuple[int, str]]:
    """Line number and text of the sentences of a page that have more words than `limit`."""
    return [(line, sentence) for line, sentence, _ in sentences(text) if words_of(sentence) > limit]


def too_long(pages: dict[str, str], limits: Mapping[str, float]) -> Iterator[str]:
    """What is longer than the limits, one line each."""
    sentence, site = int(limits["sentence"]), 0
    for path, text in pages.items():
        words, mean = len(text.split()), mean_sentence(text)
        site += words if path.startswith(f"{SITE}/") else 0
        if words > limits["page"]:
            yield f"{path}: {words} words; at most {limits['page']:g}"
        if mean > limits["mean"]:
            yield f"{path}: {mean:g} words a sentence in the mean; at most {limits['mean']:g}"
        for line, long in long_sentences(text, sentence):
            yield f"{path}:{line}: {words_of(long)} words; at most {sentence}: {long}"
    if site > limits["site"]:
        yield f"{SITE}: {site} words; at most {limits['site']:g}"


def mean_sentence(text: str) -> float:
    """Mean length of a page's sentences outside of tables [words]."""
    lengths = [words_of(sentence) for _, sentence, in_table in sentences(text) if not in_table]
    return round(sum(lengths) / max(len(lengths), 1), 1)


def tracked_files() -> list[str]:
    """Markdown and Python files under version control."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md", "*.py"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return [path for path in listed.stdout.splitlines() if (ROOT / path).is_file()]


def main() -> int:
    """Check the repository; the exit code."""
    listed = Path(__file__).with_name("terms.toml")
    terms, limits = load_terms(listed), tomllib.loads(listed.read_text())["limits"]
    paths = tracked_files()
    pages = {path: (ROOT / path).read_text() for path in paths if PAGE.match(path) and path != HISTORY[0]}
    found = [line for path in paths for line in findings(path, (ROOT / path).read_text(), terms)]
    found += too_long(pages, limits)
    print("\n".join(found), end="\n" if found else "")
    spelling = subprocess.run(["codespell", *paths], cwd=ROOT, check=False)
    print(f"{len(paths)} files, {len(found)} findings, spelling {'ok' if spelling.returncode == 0 else 'wrong'}")
    return int(bool(found) or spelling.returncode != 0)


if __name__ == "__main__":
    sys.exit(main())
