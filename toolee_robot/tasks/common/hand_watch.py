"""Ask the hand, all through a motion, whether it still holds the tool."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Self

from toolee_robot.control.watcher import Watcher
from toolee_robot.errors import DeviceError, GripError
from toolee_robot.hal import Hand

PERIOD = 0.02
"""[s] between two questions: a hand on a serial line answers some 100 a second."""


def check_held(hand: Hand) -> None:
    """Raise GripError when the hand has lost the tool, DeviceError when it complains or has fallen silent."""
    state = hand.state()
    if not state.holding:
        raise GripError("the hand has lost the tool: pick it up and start again")
    if state.fault:
        raise DeviceError(f"the hand reports a fault ({state.fault}): no further strike; look at the hand")


class HandWatch:
    """Inside this context the arm is stopped as soon as `check_held` raises. error: what it raised."""

    def __init__(self, hand: Hand, stop: Callable[[], None]) -> None:
        self.error: Exception | None = None
        self._hand = hand
        self._watcher = Watcher(self._reason_to_stop, stop, "the hand cannot be asked", PERIOD)

    def __enter__(self) -> Self:
        self._watcher.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._watcher.__exit__(kind, error, trace)
        if self.error is None and self._watcher.reason:
            self.error = DeviceError(self._watcher.reason)

    def _reason_to_stop(self) -> str:
        try:
            check_held(self._hand)
        except DeviceError as error:
            self.error = error
            return str(error)
        return ""
