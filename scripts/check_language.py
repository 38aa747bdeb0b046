"""Spelling and terms: codespell over the repository, and the terms of `terms.toml` over documents and Python prose.

Prose is the Markdown outside of code, and the docstrings, comments and strings with spaces of Python files.
Exit code 1: something was found, one line each. Example: `python scripts/check_language.py`
"""

from __future__ import annotations

import io
import re
import subprocess
import sys
import tokenize
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
HISTORY = ("docs/research_log.md", "CHANGELOG.md")
"""Documents that tell what was."""
CODE = re.compile(r"^```.*?^```|`[^`\n]*`", re.MULTILINE | re.DOTALL)


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


def tracked_files() -> list[str]:
    """Markdown and Python files under version control."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md", "*.py"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return [path for path in listed.stdout.splitlines() if (ROOT / path).is_file()]


def main() -> int:
    """Check the repository; the exit code."""
    terms = load_terms(Path(__file__).with_name("terms.toml"))
    paths = tracked_files()
    found = [line for path in paths for line in findings(path, (ROOT / path).read_text(), terms)]
    print("\n".join(found), end="\n" if found else "")
    spelling = subprocess.run(["codespell", *paths], cwd=ROOT, check=False)
    print(
        f"{len(paths)} files, {len(found)} terms to replace, spelling {'ok' if spelling.returncode == 0 else 'wrong'}"
    )
    return int(bool(found) or spelling.returncode != 0)


if __name__ == "__main__":
    sys.exit(main())
