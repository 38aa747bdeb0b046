"""pybullet, without the greeting that it writes to the standard error stream, from C, when it is loaded.

from toolee_robot.sim_backend.quiet import pb
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet_stderr() -> Iterator[None]:
    """Nothing reaches file descriptor 2 while inside; exceptions do."""
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


with quiet_stderr():
    import pybullet as pb

__all__ = ["pb"]
