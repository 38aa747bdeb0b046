"""Files: written whole or not at all; read with a limit, and with errors that can be told; the folder of a run."""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from tokenize import TokenError
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import UserError, words_of

LARGEST_TEXT = 64 * 1024**2
"""Of a text file that is read [bytes]: the results of 10,000 trials take 30 MB."""


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
        if path.exists() and not path.is_file():
            why = "it is a folder or a device"
            raise UserError(f"cannot write {path}: {why}. Choose another place")
        try:
            yield scratch
            scratch.replace(path)
        except BaseException:
            scratch.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise UserError(f"cannot write {path}: {words_of(error)}. Choose another place") from error


def write_atomic(path: Path, data: bytes | memoryview) -> None:
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


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Claim an output folder for this process; a process that was killed claims nothing.

    Args:
        folder: The folder, which exists.

    Raises:
        UserError: Another process has claimed it; the message has its number.
    """
    with (folder / ".claim").open("a+") as claim:
        try:
            fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            claim.seek(0)
            raise UserError(
                f"{folder} is in use by process {claim.read()}: wait for it, or choose another --out"
            ) from None
        claim.truncate(0)
        claim.write(str(os.getpid()))
        claim.flush()
        yield


def read_bytes(path: Path, most: int) -> bytes:
    """Read a file that is not larger than it may be.

    Args:
        path: The file.
        most: Its largest size [bytes].

    Returns:
        Its content.

    Raises:
        OSError: It cannot be read.
        ValueError: It is no file, such as `/dev/zero`, or too large.
    """
    about = path.stat()
    if not stat.S_ISREG(about.st_mode):
        raise ValueError("it is a folder or a device, no file")
    if about.st_size > most:
        raise ValueError(f"it has {about.st_size:,} bytes, more than {most:,}")
    return path.read_bytes()


def read_text(path: Path) -> str:
    """Read a text file in UTF-8, whatever the locale.

    Args:
        path: The file.

    Returns:
        Its text, without a byte order mark.

    Raises:
        OSError: It cannot be read.
        ValueError: It is no text in UTF-8, or too large.
    """
    try:
        return read_bytes(path, LARGEST_TEXT).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise ValueError(f"not UTF-8 at byte {error.start}: save the file in that encoding") from None


def from_json(text: str | bytes) -> Any:
    """Read strict JSON.

    Args:
        text: The text.

    Returns:
        Its value, of finite numbers.

    Raises:
        ValueError: It is no JSON, holds NaN or infinity, or is nested too deeply.
    """
    try:
        return json.loads(text, parse_constant=_refuse)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def read_json(path: Path) -> Any:
    """Read a file of strict JSON.

    Args:
        path: The file.

    Returns:
        Its value, of finite numbers.

    Raises:
        OSError: It cannot be read.
        ValueError: It is no text, or no JSON; see `from_json`.
    """
    return from_json(read_text(path))


def read_array(path: Path) -> NDArray[Any]:
    """Read a `.npy` array.

    Args:
        path: The file.

    Returns:
        The array, of the file's shape and type.

    Raises:
        OSError: It cannot be read.
        ValueError: It is no array of numbers, or not as long as it says.
    """
    try:
        return np.array(np.load(path, mmap_mode="r", allow_pickle=False))  # a map is never longer than the file
    except (EOFError, OverflowError, SyntaxError, TypeError, RecursionError, TokenError) as error:  # of a damaged head
        raise ValueError(f"its head is damaged: {error}") from None


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a number in JSON")


def json_line(value: Any) -> str:
    """Format a value as one line of strict JSON; NaN and infinity become null."""
    return json.dumps(_finite(value), allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value


class RunFolder:
    """Folder of a run; at the end of the context it is removed, unless `keep` was called or something was measured.

    Args:
        path: Present folder.
        final: Folder after `keep`.

    Attributes:
        path: Present folder.
        final: Folder after `keep`.
        kept: Whether `keep` was called.
        measured: Whether it holds what cannot be had again.
    """

    def __init__(self, path: Path, final: Path) -> None:
        self.path, self.final = path, final
        self.kept = self.measured = False

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
        raise UserError(f"cannot write runs to {out}: {words_of(error)}; choose another --out") from error
    folder = RunFolder(path, final)
    try:
        yield folder
    finally:
        if folder.measured and not folder.kept:
            folder.keep()
        elif not folder.kept:
            shutil.rmtree(folder.path, ignore_errors=True)
            if made_out:
                _remove_if_empty(out)


def _remove_if_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
