"""The folder of one run, written under a temporary name and renamed when it is complete."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from toolee_robot.errors import UserError, words_of


class RunFolder:
    """Folder of a run; without `keep` it is removed at the end of the context.

    Args:
        path: Present folder.
        final: Folder after `keep`.

    Attributes:
        path: Present folder.
        final: Folder after `keep`.
        kept: Whether `keep` was called.
    """

    def __init__(self, path: Path, final: Path) -> None:
        self.path, self.final = path, final
        self.kept = False

    def keep(self) -> Path:
        """Move the complete run to its final folder, with a number appended if that exists."""
        target, n = self.final, 2
        while target.exists():
            target = self.final.with_name(f"{self.final.name}-{n}")
            n += 1
        self.path.rename(target)
        self.path = self.final = target
        self.kept = True
        return target


@contextmanager
def run_folder(out: Path, name: str) -> Iterator[RunFolder]:
    """Context with a folder `out/<time>-<name>` for a run.

    Args:
        out: Parent of the folder.
        name: Name of the run.

    Yields:
        The folder.

    Raises:
        UserError: `out` cannot be written.
    """
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    made_out = not out.exists()
    final = out / f"{stamp}-{name}"
    path, n = out / f".{final.name}.partial", 2
    try:
        out.mkdir(parents=True, exist_ok=True)
        while path.exists():  # of another job that has begun in the same second
            path, n = out / f".{final.name}-{n}.partial", n + 1
        path.mkdir()
    except OSError as error:
        raise UserError(
            f"cannot write runs to {out}: {words_of(error)}; choose another --out",
            code="user.runs_not_writable",
        ) from error
    folder = RunFolder(path, final)
    try:
        yield folder
    finally:
        if not folder.kept:
            shutil.rmtree(folder.path, ignore_errors=True)
            if made_out:
                _remove_if_empty(out)


def _remove_if_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
