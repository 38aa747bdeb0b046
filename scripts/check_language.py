"""Spelling, terms and length: codespell, the terms of `terms.toml`, and its limits on sentences and pages.

Terms hold for Markdown outside of code, and for docstrings, comments and strings with spaces of Python files.
Lengths hold for the documents. A page that `terms.toml` allows more may not get worse.
Exit code 1: something was found, one line each. Example: `python scripts/check_language.py`
`--shrink` lowers what `terms.toml` allows to what the pages need now. `--pages` prints each page's counts.
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
"""Folder of the site, and what `terms.toml` calls all of its pages together."""
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


@dataclass(frozen=True)
class Counts:
    """How long a page is: also what a page may have."""

    words: int
    """Words of the whole file, code and tables included."""
    long: int
    """Sentences over the limit."""
    mean: float
    """Mean length of a sentence outside of tables [words]."""

    def line(self, path: str) -> str:
        """The page's line in `terms.toml`."""
        return f'"{path}" = {{words = {self.words}, long = {self.long}, mean = {self.mean:.1f}}}'


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


def count(text: str, limit: int) -> Counts:
    """The counts of a page."""
    lengths = [words_of(sentence) for _, sentence, in_table in sentences(text) if not in_table]
    mean = sum(lengths) / max(len(lengths), 1)
    return Counts(len(text.split()), len(long_sentences(text, limit)), round(mean, 1))


def too_long(pages: dict[str, str], limits: Mapping[str, float], allowed: Mapping[str, Counts]) -> Iterator[str]:
    """What is longer than the limits and than what is allowed, one line each."""
    sentence = int(limits["sentence"])
    for path, text in pages.items():
        now, most = count(text, sentence), allowed.get(path, Counts(0, 0, 0.0))
        if now.words > (limit := max(most.words, limits["page"])):
            yield f"{path}: {now.words} words; at most {limit:g}"
        if now.mean > (limit := max(most.mean, limits["mean"])):
            yield f"{path}: {now.mean:g} words a sentence in the mean; at most {limit:g}"
        if now.long > most.long:
            yield f"{path}: {now.long} sentences over {sentence} words; at most {most.long}"
            yield from (
                f"{path}:{line}: {words_of(long)} words: {long}" for line, long in long_sentences(text, sentence)
            )
    total, most = site_words(pages), allowed.get(SITE, Counts(0, 0, 0.0))
    if total > (limit := max(most.words, limits["site"])):
        yield f"{SITE}: {total} words; at most {limit:g}"


def site_words(pages: dict[str, str]) -> int:
    """Words of all pages of the site."""
    return sum(len(text.split()) for path, text in pages.items() if path.startswith(f"{SITE}/"))


def shrink(listed: str, pages: dict[str, str], limits: Mapping[str, float], allowed: Mapping[str, Counts]) -> str:
    """The text of `terms.toml` with no more allowed than the pages need."""
    for path, most in allowed.items():
        now = count(pages.get(path, ""), int(limits["sentence"])) if path != SITE else Counts(site_words(pages), 0, 0.0)
        least = Counts(min(now.words, most.words), min(now.long, most.long), min(now.mean, most.mean))
        kept = least.words > limits["site" if path == SITE else "page"] or least.long or least.mean > limits["mean"]
        listed = listed.replace(most.line(path) + "\n", least.line(path) + "\n" if kept else "")
    return listed


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
    terms, lengths = load_terms(listed), tomllib.loads(listed.read_text())
    limits, allowed = lengths["limits"], {path: Counts(**most) for path, most in lengths["allowed"].items()}
    paths = tracked_files()
    pages = {path: (ROOT / path).read_text() for path in paths if PAGE.match(path) and path != HISTORY[0]}
    if "--shrink" in sys.argv:
        listed.write_text(shrink(listed.read_text(), pages, limits, allowed))
        return 0
    if "--pages" in sys.argv:
        print("\n".join(count(text, int(limits["sentence"])).line(path) for path, text in pages.items()))
        return 0
    found = [line for path in paths for line in findings(path, (ROOT / path).read_text(), terms)]
    found += too_long(pages, limits, allowed)
    print("\n".join(found), end="\n" if found else "")
    spelling = subprocess.run(["codespell", *paths], cwd=ROOT, check=False)
    print(f"{len(paths)} files, {len(found)} findings, spelling {'ok' if spelling.returncode == 0 else 'wrong'}")
    return int(bool(found) or spelling.returncode != 0)


if __name__ == "__main__":
    sys.exit(main())
