"""Monitor the hand's grip throughout a motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

from toolee_robot.control.watcher import Watcher
from toolee_robot.errors import DeviceError, GripError
from toolee_robot.hal import Hand

PERIOD = 0.02
"""Polling period [s]; a hand on a serial line answers some 100 times per second."""


def check_held(hand: Hand) -> None:
    """Check that the hand holds the tool.

    Args:
        hand: The hand.

    Raises:
        GripError: The hand has lost the tool.
        DeviceError: The hand reports a fault, or does not answer.
    """
    state = hand.state()
    if not state.holding:
        raise GripError("the hand has lost the tool: pick it up and start again")
    if state.fault:
        raise DeviceError(
            f"the hand reports a fault ({state.fault}): no further strike; look at the hand", code="device.hand_fault"
        )


class HandWatch:
    """Context in which the arm is stopped as soon as `check_held` raises.

    Args:
        hand: The hand that holds the tool.
        stop: Stops the arm; called from another thread.

    Attributes:
        error: The error that stopped the arm, or None.
    """

    def __init__(self, hand: Hand, stop: Callable[[], None]) -> None:
        self.error: Exception | None = None
        self._hand = hand
        self._watcher = Watcher(self._reason_to_stop, stop, "the hand cannot be asked", PERIOD)

    def __enter__(self) -> Self:
        self._watcher.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._watcher.__exit__(*error)
        if self.error is None and self._watcher.reason:
            self.error = DeviceError(self._watcher.reason, code="device.hand_silent")

    def _reason_to_stop(self) -> str:
        try:
            check_held(self._hand)
        except DeviceError as error:
            self.error = error
            return str(error)
        return ""
