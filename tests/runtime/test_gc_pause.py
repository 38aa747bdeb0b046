"""The garbage collector during time-critical work."""

from __future__ import annotations

import gc
from collections.abc import Callable

from toolee_robot.runtime.gc_pause import gc_paused, gc_settled, gc_spared


def seen_by_a_full_collection() -> int:
    """Number of objects that a full collection goes through."""
    return sum(len(gc.get_objects(generation)) for generation in range(3))


def test_a_settled_collection_leaves_out_what_was_there_and_what_came_until_it_was_told() -> None:
    before = seen_by_a_full_collection()
    with gc_settled() as settle:
        assert seen_by_a_full_collection() < before / 10
        station: list[Callable[[], int]] = [lambda: 1 for _ in range(5000)]
        assert seen_by_a_full_collection() > 5000
        settle()
        assert seen_by_a_full_collection() < 5000
    assert seen_by_a_full_collection() > before / 2 + len(station)


def test_cycles_are_still_collected_while_it_is_settled() -> None:
    class Node:
        alive = 0

        def __init__(self) -> None:
            Node.alive += 1
            self.itself = self

        def __del__(self) -> None:
            Node.alive -= 1

    with gc_settled():
        Node()
        assert Node.alive == 1
        gc.collect()
        assert Node.alive == 0


def test_a_pause_ends_as_it_began() -> None:
    with gc_paused():
        assert not gc.isenabled()
    assert gc.isenabled()


def test_what_came_while_the_collector_was_spared_is_left_out_from_then_on() -> None:
    try:
        with gc_spared():
            assert not gc.isenabled()
            module: list[Callable[[], int]] = [lambda: 1 for _ in range(5000)]
        assert gc.isenabled()
        assert seen_by_a_full_collection() < len(module)
    finally:
        gc.unfreeze()
