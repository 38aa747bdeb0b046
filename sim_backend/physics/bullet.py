"""pybullet, without what it writes to the standard streams, from C: a greeting when it is loaded, warnings later.

from toolee_robot.sim_backend.physics.bullet import pb
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet(descriptor: int) -> Iterator[None]:
    """Nothing reaches file descriptor 1 (standard output) or 2 (standard error) while inside; exceptions do."""
    (sys.stdout if descriptor == 1 else sys.stderr).flush()
    c_library = ctypes.CDLL(None)  # its streams have buffers of their own
    c_library.fflush(None)
    kept = os.dup(descriptor)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, descriptor)
        yield
    finally:
        c_library.fflush(None)
        os.dup2(kept, descriptor)
        os.close(kept)
        os.close(nowhere)


with quiet(2):
    import pybullet as pb

__all__ = ["pb", "quiet"]
