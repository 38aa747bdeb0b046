"""One bad reading of the grip is a doubt, not a loss: it stops the arm, and the hand is asked for longer."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain, repeat

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.errors import raises
from toolee_robot.end_effectors import Category
from toolee_robot.errors import DeviceError, GripError
from toolee_robot.frames import Array, angle_between, transform
from toolee_robot.hal import HandState
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.look import STEADY, STEADY_ANGLE, holding_between
from toolee_robot.tasks.common.observer import Observers, TaskObserver
from toolee_robot.tasks.common.outcome import HammerResult, Outcome, Stage
from toolee_robot.tasks.common.watches import ASKED_FOR, GRIP_PERIOD, HOLDS_FOR, check_held
from toolee_robot.types import InHandEstimate, JointState, Payload

STEADY_HAND_WATCH = round(HOLDS_FOR / GRIP_PERIOD)


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
        check_held(Readings(*[False, *[True] * (STEADY_HAND_WATCH - 1)] * 8, False), Clock())


def test_a_fault_is_not_waited_out() -> None:
    clock = Clock()
    with raises(DeviceError, says="the hand reports a fault ("):
        check_held(Readings(True, fault="index finger stalled"), clock)
    assert clock.time == 0.0


@given(st.lists(st.booleans(), min_size=1, max_size=80))
def test_it_is_held_exactly_if_it_is_so_for_its_time(grips: list[bool]) -> None:
    """At once, or after a doubt for HOLDS_FOR on end within ASKED_FOR."""
    readings = [*grips, *repeat(grips[-1], 80)][: round(ASKED_FOR / GRIP_PERIOD)]
    steady = "".join("x" if grip else "." for grip in readings)
    held = readings[0] or "x" * (STEADY_HAND_WATCH + 2) in steady
    surely_not = not readings[0] and "x" * STEADY_HAND_WATCH not in steady
    try:
        check_held(Readings(*grips), Clock())
    except GripError:
        assert not held
    else:
        assert not surely_not


BEFORE = transform(Rotation.from_rotvec([0.1, 0.7, -2.0]), [0.2, -0.03, 0.1])
USUAL = np.deg2rad(0.4)
HELD = HeldTool.nominally(BEFORE, Payload(0.6, np.array([0.0, 0.02, -0.1])))


def seen(X: Array, sigma: float = 1e-4) -> InHandEstimate:
    covariance = np.diag([1e-6] * 3 + [sigma**2] * 3)
    return InHandEstimate(Category.HAMMER_HEAD, X, covariance, 0.9, 2, 2, True, "ok")


@given(st.floats(-np.pi, np.pi), st.floats(0.001, 0.2), st.floats(-3.0, 3.0), st.integers(1, 12))
def test_what_is_seen_clearly_goes_on_as_it_was(direction: float, angle: float, spin: float, strikes: int) -> None:
    turn = transform(Rotation.from_rotvec([angle * np.cos(direction), angle * np.sin(direction), 0.0]))
    # The spin about the normal is the hand's, and no turn of the face.
    now = BEFORE @ turn @ transform(Rotation.from_rotvec([0.0, 0.0, spin]))
    steady, turned = holding_between(seen(BEFORE), seen(now), strikes, USUAL)
    held = replace(HELD, turn=turned)
    for _ in range(strikes):
        held = held.turned()
    X = held.X_hand_ee
    # A steady tool's turn is the noise of two looks.
    assert angle_between(X[:3, 2], (BEFORE if steady else now)[:3, 2]) < 0.01 * angle + 1e-9
    np.testing.assert_array_equal(X[:3, 3], BEFORE[:3, 3])


def test_what_is_seen_badly_is_believed_in_part() -> None:
    now = BEFORE @ transform(Rotation.from_rotvec([np.deg2rad(4.0), 0.0, 0.0]))
    turns = [holding_between(seen(BEFORE, s), seen(now, s), 4, USUAL)[1][0] for s in np.deg2rad([0.01, 0.5, 1.0, 5.0])]
    assert np.all(np.diff(turns) < 0.0)
    assert 4 * turns[0] == pytest.approx(np.deg2rad(4.0), rel=0.01)
    assert 0.0 < 4 * turns[-1] < np.deg2rad(0.4)


@pytest.mark.parametrize(
    ("aside", "along", "angle", "steady"),
    [
        (0.0, 0.0, 0.0, True),
        (3.9 * STEADY, 0.0, 3.9 * STEADY_ANGLE, True),
        (0.0, 0.012, 0.0, True),
        (4.1 * STEADY, 0.0, 0.0, False),
        (0.0, 0.0, 4.1 * STEADY_ANGLE, False),
    ],
)
def test_a_tool_that_slips_along_the_normal_alone_is_steady(
    aside: float, along: float, angle: float, steady: bool
) -> None:
    """Touches measure that slip."""
    now = BEFORE @ transform(Rotation.from_rotvec([angle, 0.0, 0.0]), [aside, 0.0, along])
    assert holding_between(seen(BEFORE), seen(now), 4, USUAL)[0] is steady


def test_of_one_look_nothing_is_concluded() -> None:
    np.testing.assert_array_equal(HELD.turned().X_hand_ee, BEFORE)
    assert not HELD.steady


def test_a_weighed_tools_centre_of_mass_stays_in_the_hand_and_a_told_ones_with_the_face() -> None:
    now = BEFORE @ transform(Rotation.from_rotvec([0.0, 0.2, 0.0]), [0.0, 0.0, 0.01])
    assert HELD.moved(now).payload is HELD.payload
    weighed = replace(HELD, weighed=True)
    in_hand = [
        X @ np.append(held.payload.center_of_mass, 1.0) for X, held in ((BEFORE, weighed), (now, weighed.moved(now)))
    ]
    np.testing.assert_allclose(in_hand[0], in_hand[1], atol=1e-12)


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
