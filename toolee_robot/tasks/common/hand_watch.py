"""Monitor the hand's grip: the first doubt stops the arm, and the hand is then asked for longer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

from toolee_robot.control.supervisor_checks import Watcher
from toolee_robot.errors import DeviceError, GripError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock, Hand, HandState

PERIOD = 0.02
"""Polling period [s]; a hand on a serial line answers some 100 times per second."""
HOLDS_FOR = 0.2
"""Time for which the hand must report its grip without interruption after a doubt [s]: 10 successive readings."""
ASKED_FOR = 1.0
"""Longest time for which the hand is asked after a doubt; without a steady answer the tool counts as lost [s]."""

MAX_DOUBTS = 3
"""Number of motions between two strikes, or of one weighing, that a doubt may interrupt before a person is asked."""


def _check_fault(state: HandState) -> None:
    if state.fault:
        raise DeviceError(
            f"the hand reports a fault ({state.fault}): no further strike; look at the hand", code="device.hand_fault"
        )


def check_held(hand: Hand, clock: Clock) -> None:
    """Check at standstill that the hand holds the tool; one bad reading is not believed, nor is a grip that flickers.

    Args:
        hand: The hand.
        clock: Clock of the station.

    Raises:
        GripError: The hand has lost the tool: over ASKED_FOR it never reported its grip for HOLDS_FOR.
        DeviceError: The hand reports a fault, or does not answer.
    """
    end = clock.now() + ASKED_FOR
    held_since: float | None = None
    doubted = False
    while (now := clock.now()) <= end:
        state = hand.state()
        if state.holding:
            held_since = now if held_since is None else held_since
            if not doubted or now - held_since >= HOLDS_FOR - 1e-9:
                _check_fault(state)
                return
        else:
            held_since, doubted = None, True
        clock.sleep(PERIOD)
    raise GripError("the hand has lost the tool: pick it up and start again")


class HandWatch:
    """Context in which the arm is stopped at the first reading without a grip, or with a fault.

    Standing still is safe, and a hammer that leaves the hand in a strike is not: a doubt costs nothing but time.

    Args:
        hand: The hand that holds the tool.
        stop: Stops the arm; called from another thread.

    Attributes:
        course: The joints' positions, (n,) [rad], by time [s], as they were read.
        error: The error that stopped the arm, or None.
        doubted: Whether a single reading without a grip stopped the arm; `check_held` finds out whether it was true.
    """

    def __init__(self, hand: Hand, stop: Callable[[], None]) -> None:
        self.course: list[tuple[float, Array]] = []
        self.error: Exception | None = None
        self.doubted = False
        self._hand = hand
        self._watcher = Watcher(self._reason_to_stop, stop, "the hand cannot be asked", PERIOD)

    def __enter__(self) -> Self:
        self._watcher.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._watcher.__exit__(*error)
        if self.error is None and not self.doubted and self._watcher.reason:
            self.error = DeviceError(self._watcher.reason, code="device.hand_silent")

    def _reason_to_stop(self) -> str:
        try:
            state = self._hand.state()
            if not self.course or state.joints.stamp > self.course[-1][0]:
                self.course.append((state.joints.stamp, state.joints.q))
            if not state.holding:
                self.doubted = True
                return "the hand does not report its grip"
            _check_fault(state)
        except DeviceError as error:
            self.error = error
            return str(error)
        return ""
