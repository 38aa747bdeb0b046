"""Processes: which code they run, and the environment of those that are started."""

from __future__ import annotations

import contextlib
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import toolee_robot


def code_version() -> str:
    """The package's version and, from a git checkout, its commit.

    Returns:
        Such as "0.2.0" or "0.2.0 a1b2c3d4e5f6", with "-dirty" appended where tracked files differ from the commit.
    """
    version = toolee_robot.__version__
    folder = Path(toolee_robot.__file__).parent
    command = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=12", "--match="]
    try:
        found = subprocess.run(command, capture_output=True, text=True, timeout=10.0, check=True)
    except (OSError, subprocess.SubprocessError):
        return version
    return f"{version} {found.stdout.strip()}"


ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"), "1"
)
"""Environment of workers: without it, Embree, BLAS, torch and OpenCV start one thread per core in each of them."""


@contextlib.contextmanager
def environment(variables: dict[str, str]) -> Iterator[None]:
    """Context in which processes are started with further environment variables.

    Args:
        variables: Their names and values.
    """
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name)
            else:
                os.environ[name] = value
