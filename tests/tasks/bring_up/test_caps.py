"""Whatever a bring-up is asked for, the arm gets nothing that is faster than the caps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.control.paper_arm import Bystander, PaperArm
from tests.errors import raises
from tests.examples import examples
from tests.sim_backend.kinematics import line
from toolee_robot.control import Supervisor
from toolee_robot.control.motion.touch_force import TouchSettings
from toolee_robot.errors import DeviceError, LimitError, TooleeError, UserError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmState, ContactGuard, MotionReport, MotionWatch
from toolee_robot.station import sim_station
from toolee_robot.tasks.bring_up.lag import lag_motion
from toolee_robot.tasks.bring_up.slow_motions import (
    ACCELERATION,
    SPEED,
    Caps,
    MotionFrame,
    Place,
    SlowStation,
    jog_joint,
    plan_joints,
    plan_line,
    plan_to_place,
)
from toolee_robot.tasks.bring_up.touch import SPEED as TOUCH_SPEED
from toolee_robot.tasks.bring_up.touch import Touch, approach
from toolee_robot.types import Trajectory

STATION = sim_station()
HOME = np.array(STATION.scene.home)


class ListeningArm(PaperArm):
    """An arm on paper that keeps the trajectories that it was given. presses: force at rest after a contact [N]."""

    def __init__(self, q: Array) -> None:
        super().__init__(q)
        self.given: list[Trajectory] = []
        self.presses, self._touches = 1e4, False

    def state(self, max_age: float = 0.1) -> ArmState:
        state = super().state(max_age)
        return replace(state, wrench=np.array([0.0, 0.0, self.presses * self._touches, 0.0, 0.0, 0.0]))

    def execute(
        self, trajectory: Trajectory, guard: ContactGuard | None = None, watch: MotionWatch | None = None
    ) -> MotionReport:
        self.given.append(trajectory)
        report = super().execute(trajectory, guard, watch)
        self._touches = report.contact is not None
        return report


_number = st.one_of(st.floats(-0.3, 0.3), st.floats(), st.floats(-10.0, 10.0))
_three = st.tuples(_number, _number, _number)
_frame = st.sampled_from(list(MotionFrame))
_starts = st.lists(st.floats(-0.3, 0.3), min_size=6, max_size=6).map(lambda change: HOME + change)
_caps = st.one_of(st.just((SPEED, ACCELERATION)), st.tuples(st.floats(1e-3, 50.0), st.floats(1e-2, 500.0)))
_moves = st.one_of(
    st.builds(lambda joint, by: _jog(joint, by), st.integers(-1, 8), _number),
    st.builds(lambda to: _to(np.array(to)), st.tuples(*[_number] * 6)),
    st.builds(lambda change: _to(HOME + change), st.lists(st.floats(-1, 1), min_size=6, max_size=6)),
    st.builds(lambda along, frame: _line(along, frame), _three, _frame),
)
_touches = st.builds(
    lambda along, frame, speed, force: Approach(along, frame, speed, force),
    *(_three, _frame, _number, st.floats(0.1, 1e3)),
)

Plan = Callable[[SlowStation, Array], Trajectory]


@dataclass(frozen=True)
class Approach:
    """A guarded approach."""

    along: tuple[float, float, float]
    frame: MotionFrame = MotionFrame.BASE_LINK
    speed: float = TOUCH_SPEED
    force: float = 1.0

    def __call__(self, slow: SlowStation, q: Array) -> Trajectory:
        return plan_line(slow, q, np.array(self.along), self.frame, self.speed)


def _jog(joint: int, by: float) -> Plan:
    return lambda slow, q: plan_joints(slow, q, jog_joint(q, joint, by))


def _to(goal: Array) -> Plan:
    return lambda slow, q: plan_joints(slow, q, goal)


def _line(along: tuple[float, float, float], frame: MotionFrame) -> Plan:
    return lambda slow, q: plan_line(slow, q, np.array(along), frame)


def _transfer(place: Place) -> Plan:
    return lambda slow, q: plan_to_place(slow, q, place)


def _executed(plan: Plan, slow: SlowStation, q: Array) -> list[Trajectory]:
    """What an arm is given when the motion is carried out; nothing where it is refused."""
    arm = ListeningArm(q)
    supervisor = Supervisor(arm, Bystander(), slow.robot, slow.config, lambda: slow.world)
    try:
        trajectory = plan(slow, q)
        if isinstance(plan, Approach):
            arm.meets = 0.5
            approach(supervisor, slow, trajectory, TouchSettings(plan.force, 0.024, plan.speed, None, 0.0, 12.0))
        else:
            supervisor.execute(trajectory)
    except TooleeError:
        pass
    return arm.given


def _assert_slow(trajectory: Trajectory, speed: float, acceleration: float) -> None:
    h = np.diff(trajectory.times)[:, None]
    assert np.abs(trajectory.qd).max() <= 1.001 * speed
    assert np.abs(trajectory.qdd).max() <= 1.001 * acceleration
    assert np.abs(np.diff(trajectory.q, axis=0) / h).max() <= 1.011 * speed, "between the samples"
    assert np.abs(np.diff(trajectory.qd, axis=0) / h).max() <= 1.05 * acceleration + 1e-3, "between the samples"


@examples(40)
@given(st.one_of(_moves, _touches), _starts, _caps)
def test_no_arguments_make_a_motion_faster_than_its_caps(plan: Plan, q: Array, caps: tuple[float, float]) -> None:
    slow = SlowStation.of(STATION, Caps(*caps))
    for trajectory in _executed(plan, slow, q):
        _assert_slow(trajectory, min(caps[0], 3.14), min(caps[1], STATION.arm.transfer_acceleration))


@examples(5)
@given(st.sampled_from([Place.HOME, Place.HANDOVER, Place.NAIL]), _starts)
def test_no_transfer_is_faster_than_the_caps(place: Place, q: Array) -> None:
    slow = SlowStation.of(STATION, Caps())
    for trajectory in _executed(_transfer(place), slow, q):
        _assert_slow(trajectory, SPEED, ACCELERATION)


@examples(30)
@given(st.integers(1, 6), st.floats(1e-3, 10.0), _caps)
def test_no_measurement_of_the_lag_is_faster_than_the_caps(joint: int, speed: float, caps: tuple[float, float]) -> None:
    slow = SlowStation.of(STATION, Caps(*caps))
    _assert_slow(lag_motion(HOME, joint, speed, slow.config.arm).trajectory, *caps)


@pytest.mark.parametrize(
    "plan",
    [
        _jog(3, 0.05),
        _line((0.0, 0.0, 0.05), MotionFrame.PENDANT_BASE),
        _line((0.0, 0.0, -0.02), MotionFrame.TOOL),
        Approach((0.0, 0.0, -0.05)),
        *(_transfer(place) for place in (Place.HANDOVER, Place.NAIL, Place.VIEW)),
    ],
)
def test_what_a_bring_up_asks_for_is_carried_out(plan: Plan) -> None:
    given = _executed(plan, SlowStation.of(STATION, Caps()), HOME)
    assert len(given) == (2 if isinstance(plan, Approach) else 1)
    assert np.ptp(given[0].q, axis=0).max() > 0.01
    if isinstance(plan, Approach):
        np.testing.assert_allclose(given[1].q[-1], given[0].q[0], atol=1e-6)


def test_a_touch_that_feels_contacts_where_nothing_presses_goes_on_and_gives_up_after_three() -> None:
    slow = SlowStation.of(STATION, Caps())
    arm = ListeningArm(HOME)
    arm.meets, arm.presses = 0.2, 1.0
    plan = Approach((0.0, 0.0, -0.05))
    supervisor = Supervisor(arm, Bystander(), slow.robot, slow.config, lambda: slow.world)
    with raises(DeviceError, code="device.force_noise"):
        approach(supervisor, slow, plan(slow, HOME), TouchSettings(8.0, 0.024, 0.01, None, 0.0, 12.0))
    heights = [slow.robot.arm.fk(trajectory.q[-1])[2, 3] for trajectory in arm.given]
    np.testing.assert_allclose(heights[:3], heights[0], atol=1e-6)
    np.testing.assert_allclose(arm.q, HOME, atol=1e-6)


def test_a_touch_is_told_before_the_way_back_which_may_end_in_a_stop() -> None:
    class StoppedOnItsWayBack(ListeningArm):
        def execute(
            self, trajectory: Trajectory, guard: ContactGuard | None = None, watch: MotionWatch | None = None
        ) -> MotionReport:
            if self.given:
                raise DeviceError("stopped", code="device.arm")
            return super().execute(trajectory, guard, watch)

    slow = SlowStation.of(STATION, Caps())
    arm = StoppedOnItsWayBack(HOME)
    arm.meets = 0.5
    plan = Approach((0.0, 0.0, -0.05))
    supervisor = Supervisor(arm, Bystander(), slow.robot, slow.config, lambda: slow.world)
    settings = TouchSettings(8.0, 0.024, 0.01, None, 0.0, 12.0)
    met: list[Touch] = []
    with raises(DeviceError, code="device.arm"):
        approach(supervisor, slow, plan(slow, HOME), settings, met=met.append)
    (touch,) = met
    assert 0.0 < touch.travelled < 0.05


def test_the_supervisor_itself_refuses_what_is_over_the_caps() -> None:
    """So that a mistake in a plan is none in a motion."""
    slow = SlowStation.of(STATION, Caps())
    arm = ListeningArm(HOME)
    supervisor = Supervisor(arm, Bystander(), slow.robot, slow.config, lambda: slow.world)
    for change, duration, code in (
        (0.1, 1.5, "limit.velocity"),
        (0.01, 0.2, "limit.acceleration"),
        (0.001, 0.15, "limit.jerk"),
    ):
        with raises(LimitError, code=code):
            supervisor.execute(line([HOME, HOME + change], duration))
    assert not arm.given


def test_caps_only_lower_the_limits_of_a_station() -> None:
    slower = replace(STATION, arm=replace(STATION.arm, velocity=(0.05,) * 6, transfer_acceleration=0.5))
    arm = Caps(100.0, 1000.0).apply(slower).arm
    assert (arm.velocity, arm.transfer_acceleration, arm.acceleration) == ((0.05,) * 6, 0.5, 0.5)
    assert arm.stop_acceleration == STATION.arm.stop_acceleration
    assert Caps(100.0, 1000.0).apply(STATION).arm.transfer_velocity_scale == STATION.arm.transfer_velocity_scale
    assert Caps().apply(STATION).arm.stop_acceleration == ACCELERATION


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_a_cap_that_is_no_number_is_refused(value: float) -> None:
    for caps in ({"speed": value}, {"acceleration": value}):
        with raises(UserError, code="user.cap"):
            Caps(**caps)
