"""Pauses that Python's own garbage collector makes, kept away from what must not wait."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def gc_paused() -> Iterator[None]:
    """The collector stops all threads of a task with its libraries for up to 0.2 s, an arm's heartbeat too: not within
    this block. It is not in `hardware`, which may not reach for `gc`: it finds every object there is, the simulation's
    truth too."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
