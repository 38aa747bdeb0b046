"""Folders that tests compare."""

from __future__ import annotations

import filecmp
from pathlib import Path


def files(root: Path) -> list[str]:
    return sorted(p.relative_to(root).as_posix() for p in root.rglob("*"))


def assert_same(a: Path, b: Path) -> None:
    assert set(files(a)) == set(files(b))
    for name in files(a):
        assert (a / name).is_dir() or filecmp.cmp(a / name, b / name, shallow=False), name
