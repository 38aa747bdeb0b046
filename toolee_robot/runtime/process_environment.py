"""Environment variables of the processes that are started."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

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
