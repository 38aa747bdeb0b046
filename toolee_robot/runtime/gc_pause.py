"""Python's garbage collector during time-critical work: suspended, or short."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
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


@contextmanager
def gc_spared() -> Iterator[None]:
    """Context of imports, through whose objects the garbage collector does not go.

    Modules stay until the process ends. The collector would go through all of them a dozen times while those of torch
    and its like are imported, for a second or more, and find nothing.
    """
    with gc_paused():
        yield
    gc.freeze()


@contextmanager
def gc_settled() -> Iterator[Callable[[], None]]:
    """Context in which a collection goes through what is new only, and is short.

    With the networks and a station loaded a full one takes some 0.2 s, in which no thread runs: nearly the
    time after which a driver takes its device for silent. Nothing that was there at the beginning is freed before the
    end.

    Returns:
        The context. Its value adds what has come since: call it when a station has been opened.
    """
    gc.collect()
    gc.freeze()
    try:
        yield gc.freeze
    finally:
        gc.unfreeze()
