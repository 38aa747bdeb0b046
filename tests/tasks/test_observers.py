"""Observers are told in order; a job's own record does not depend on them."""

from __future__ import annotations

import inspect

from toolee_robot.tasks.common.observer import Observers, TaskObserver
from toolee_robot.tasks.common.outcome import HammerResult, Outcome, Stage


def _calls() -> list[str]:
    return [name for name, member in inspect.getmembers(TaskObserver, inspect.isfunction) if not name.startswith("_")]


def _recorder(name: str, heard: list[tuple[str, str, tuple[object, ...]]]) -> TaskObserver:
    """An observer that writes down every call it gets."""

    def hears(call: str) -> object:
        return lambda _self, *args: heard.append((name, call, args))

    kind = type("Recorder", (TaskObserver,), {call: hears(call) for call in _calls()})
    return kind()


def test_every_call_reaches_every_observer_in_order() -> None:
    heard: list[tuple[str, str, tuple[object, ...]]] = []
    observers = Observers(_recorder("first", heard), _recorder("second", heard))
    for call in _calls():
        heard.clear()
        method = getattr(observers, call)
        args = tuple(object() for _ in inspect.signature(method).parameters)
        method(*args)
        assert heard == [("first", call, args), ("second", call, args)]


def test_no_observers_is_fine() -> None:
    Observers().stage_started(Stage.VIEW)


def test_only_flush_is_success() -> None:
    successes = [o for o in Outcome if HammerResult(o, "", (), None).success]
    assert successes == [Outcome.FLUSH]
