"""Folders that tests compare."""

from __future__ import annotations

import filecmp
import hashlib
from pathlib import Path


def files(root: Path) -> list[str]:
    return sorted(p.relative_to(root).as_posix() for p in root.rglob("*"))


def assert_same(a: Path, b: Path) -> None:
    assert set(files(a)) == set(files(b))
    for name in files(a):
        assert (a / name).is_dir() or filecmp.cmp(a / name, b / name, shallow=False), name


def unsound(root: Path) -> set[str]:
    """Files of a data set that its lists of checksums lack, or have otherwise; by its paths."""
    told: dict[str, str] = {}
    for sums in root.rglob("SHA256SUMS"):
        folder = sums.parent.relative_to(root)
        told |= {(folder / line[66:]).as_posix(): line[:64] for line in sums.read_text().splitlines()}
    there = {name: root / name for name in files(root) if (root / name).is_file() and name != "SHA256SUMS"}
    assert told, "a data set that is finished"
    same = {name for name, path in there.items() if hashlib.sha256(path.read_bytes()).hexdigest() == told.get(name)}
    return {*told, *there} - same
