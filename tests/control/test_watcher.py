"""The watcher that stops an arm in motion."""

from __future__ import annotations

import threading

from toolee_robot.control.supervisor_checks import Watcher


def test_a_stop_that_comes_too_soon_is_repeated() -> None:
    """An arm that has not begun to move when it is told to stop would set off: it is told again, until it is over."""
    told: list[int] = []
    begun, stopped = threading.Event(), threading.Event()

    def stop() -> None:
        told.append(1)
        if begun.is_set():
            stopped.set()
        elif len(told) == 2:
            begun.set()

    with Watcher(lambda: "somebody is near", stop, "nobody can tell") as watcher:
        assert stopped.wait(10.0)
    assert watcher.reason == "somebody is near"
    count = len(told)
    assert not threading.Event().wait(0.05)
    assert len(told) == count, "it is over"


def test_what_cannot_be_asked_is_a_reason() -> None:
    stopped = threading.Event()

    def ask() -> str:
        raise OSError("no cable")

    with Watcher(ask, stopped.set, "nobody can tell") as watcher:
        assert stopped.wait(10.0)
    assert watcher.reason == "nobody can tell: no cable"


def test_nothing_is_stopped_without_a_reason() -> None:
    asked, stopped = threading.Event(), threading.Event()

    def ask() -> str:
        asked.set()
        return ""

    with Watcher(ask, stopped.set, "nobody can tell", period=1e-3) as watcher:
        assert asked.wait(10.0)
    assert (watcher.reason, stopped.is_set()) == ("", False)
