"""Suspension of Python's garbage collector during time-critical work."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def gc_paused() -> Iterator[None]:
    """Context in which the garbage collector does not run.

    A collection stops all threads for up to 0.2 s, including that of the arm's heartbeat. The function is not part of
    `hardware`, which may not import `gc`, since `gc` gives access to every object, including the simulation's ground
    truth.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
