"""One bad reading of the grip is a doubt, not a loss: it stops the arm, and the hand is asked for longer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain, repeat

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.errors import raises
from toolee_robot.errors import DeviceError, GripError
from toolee_robot.hal import HandState
from toolee_robot.tasks.common.watches import ASKED_FOR, GRIP_PERIOD, HOLDS_FOR, check_held
from toolee_robot.types import JointState

STEADY = round(HOLDS_FOR / GRIP_PERIOD)


@dataclass
class Clock:
    time: float = 0.0

    def now(self) -> float:
        return self.time

    def sleep(self, duration: float) -> None:
        self.time += duration


class Readings:
    """A hand that reports these grips, one a reading, and the last one from then on; fault: what it reports besides."""

    def __init__(self, *grips: bool, fault: str = "") -> None:
        self._grips: Iterator[bool] = chain(grips, repeat(grips[-1]))
        self._state = HandState(JointState(np.zeros(2), np.zeros(2), 0.0), {}, True, fault=fault)
        self.asked = 0
        self.joint_names = ("wrist", "finger")

    def state(self, max_age: float = 0.1) -> HandState:  # noqa: ARG002
        self.asked += 1
        return replace(self._state, holding=next(self._grips))

    def __enter__(self) -> Readings:
        return self

    def __exit__(self, *_: object) -> None: ...

    def open(self, timeout: float = 5.0) -> None: ...

    def close(self, timeout: float = 5.0) -> None: ...

    def stop(self) -> None: ...


def test_a_hand_that_holds_is_asked_once() -> None:
    hand, clock = Readings(True), Clock()
    check_held(hand, clock)
    assert (hand.asked, clock.time) == (1, 0.0)


def test_one_bad_reading_is_not_believed() -> None:
    """LAB.md, defect 10."""
    clock = Clock()
    check_held(Readings(False, True), clock)
    assert HOLDS_FOR <= clock.time <= HOLDS_FOR + 2 * GRIP_PERIOD


def test_a_hand_that_holds_nothing_has_lost_the_tool() -> None:
    clock = Clock()
    with raises(GripError, "grip"):
        check_held(Readings(False), clock)
    assert clock.time == pytest.approx(ASKED_FOR, abs=2 * GRIP_PERIOD)


def test_a_grip_that_flickers_is_lost() -> None:
    with raises(GripError, "grip"):
        check_held(Readings(*[False, *[True] * (STEADY - 1)] * 8, False), Clock())


def test_a_fault_is_not_waited_out() -> None:
    clock = Clock()
    with raises(DeviceError, "device.hand_fault"):
        check_held(Readings(True, fault="index finger stalled"), clock)
    assert clock.time == 0.0


@given(st.lists(st.booleans(), min_size=1, max_size=80))
def test_it_is_held_exactly_if_it_is_so_for_its_time(grips: list[bool]) -> None:
    """At once, or after a doubt for HOLDS_FOR on end within ASKED_FOR."""
    readings = [*grips, *repeat(grips[-1], 80)][: round(ASKED_FOR / GRIP_PERIOD)]
    steady = "".join("x" if grip else "." for grip in readings)
    held = readings[0] or "x" * (STEADY + 2) in steady
    surely_not = not readings[0] and "x" * STEADY not in steady
    try:
        check_held(Readings(*grips), Clock())
    except GripError:
        assert not held
    else:
        assert not surely_not
