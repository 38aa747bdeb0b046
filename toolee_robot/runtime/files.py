"""Atomic writing of files."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from toolee_robot.errors import UserError, words_of


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Write a file atomically, also against concurrent writers.

    Args:
        path: Where it will be; its folder exists.

    Yields:
        A scratch file beside it, to write to. It becomes `path` when the context is left, and is removed when an
        exception leaves it.

    Raises:
        UserError: The place cannot be written.
    """
    scratch = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        try:
            yield scratch
            scratch.replace(path)
        except BaseException:
            scratch.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise UserError(
            f"cannot write {path}: {words_of(error)}; choose another place", code="user.not_writable"
        ) from error


def write_atomic(path: Path, data: bytes) -> None:
    """Write a file atomically; see `written_whole`.

    Args:
        path: The file; its folder exists.
        data: Its content.

    Raises:
        UserError: The place cannot be written.
    """
    with written_whole(path) as scratch:
        scratch.write_bytes(data)


def sha256(path: Path) -> str:
    """Compute the checksum of a file.

    Args:
        path: The file.

    Returns:
        SHA-256 of its bytes, hexadecimal.

    Raises:
        OSError: It cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
