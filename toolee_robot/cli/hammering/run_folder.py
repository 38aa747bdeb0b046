"""The folder of one run: written beside its place and moved there when it is whole."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from toolee_robot.errors import UserError


class RunFolder:
    """`path` is where files go now; `final` is where they will be. Leaving the context without `keep` removes all."""

    def __init__(self, path: Path, final: Path) -> None:
        self.path, self.final = path, final
        self.kept = False

    def keep(self) -> Path:
        """The run is told whole: move it to its place, with a number added should that be taken."""
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
    """A folder `out/<time>-<name>` for a run. Raises UserError when `out` cannot be written."""
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    made_out = not out.exists()
    final = out / f"{stamp}-{name}"
    path = out / f".{final.name}.partial"
    try:
        path.mkdir(parents=True, exist_ok=False)
    except OSError as error:
        raise UserError(f"cannot write runs to {out}: {error.strerror or error}; choose another --out") from error
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
