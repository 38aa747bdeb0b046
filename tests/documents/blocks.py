"""The code blocks of the documents."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
_BLOCK = re.compile(r"^( *)```(\w*)\n(.*?)^\1```", re.MULTILINE | re.DOTALL)


def blocks(language: str) -> Iterator[tuple[Path, str]]:
    """Document and text of each code block of a language ("" for none)."""
    for path in DOCUMENTS:
        for indent, name, text in _BLOCK.findall(path.read_text()):
            if name == language:
                yield path, "\n".join(line.removeprefix(indent) for line in text.splitlines())


def commands() -> Iterator[tuple[Path, list[str]]]:
    """Document and arguments of each `toolee` command in a block."""
    for path, text in (*blocks("bash"), *blocks("")):
        for line in re.sub(r"\\\n", " ", text).splitlines():
            for command in re.split(r"&&|\||&\s*(?:#|$)", re.sub(r"(^|\s)#.*", "", line)):
                words = command.split()
                if words[:1] == ["toolee"]:
                    yield path, words[1:]
