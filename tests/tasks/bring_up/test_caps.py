"""Whatever a `toolee arm` command is asked for, the arm gets nothing that is faster than the caps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.control.paper_arm import Bystander, PaperArm
from tests.errors import raises
from tests.examples import examples
from tests.sim_backend.kinematics import line
from toolee_robot.cli.arm.move import Move
from toolee_robot.cli.arm.options import MotionOptions
from toolee_robot.cli.arm.touch import Touch
from toolee_robot.cli.arm.transfer import Transfer
from toolee_robot.control import Supervisor
from toolee_robot.control.motion.touch_force import TouchSettings
from toolee_robot.errors import DeviceError, LimitError, TooleeError, UserError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmState, ContactGuard, MotionReport, MotionWatch
from toolee_robot.station import StationConfig
from toolee_robot.tasks.bring_up.caps import ACCELERATION, SPEED, Caps, SlowStation
from toolee_robot.tasks.bring_up.lag_motion import lag_motion
from toolee_robot.tasks.bring_up.touch import Touch as Contact
from toolee_robot.tasks.bring_up.touch import approach
from toolee_robot.types import Trajectory

STATION = StationConfig()
HOME = np.array(STATION.scene.home)
HOST = "127.0.0.2"


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
_frame = st.sampled_from(["pendant_base", "base_link", "tool"])
_starts = st.lists(st.floats(-0.3, 0.3), min_size=6, max_size=6).map(lambda change: HOME + change)
_caps = st.one_of(st.just((SPEED, ACCELERATION)), st.tuples(st.floats(1e-3, 50.0), st.floats(1e-2, 500.0)))
_plain = st.one_of(
    st.builds(lambda joint, by: {"joint": joint, "by": by}, st.integers(-1, 8), _number),
    st.builds(lambda to: {"to": to}, st.tuples(*[_number] * 6)),
    st.builds(
        lambda change: {"to": tuple((HOME + change).tolist())}, st.lists(st.floats(-1, 1), min_size=6, max_size=6)
    ),
    st.builds(lambda along, frame: {"along": along, "frame": frame}, _three, _frame),
)
_moves = st.builds(lambda options: Move(robot_host=HOST, **options), _plain)
_touches = st.builds(
    lambda along, frame, speed, force: Touch(robot_host=HOST, along=along, frame=frame, speed=speed, force=force),
    *(_three, _frame, _number, st.floats(0.1, 1e3)),
)
_transfers = st.sampled_from(
    [
        Transfer(robot_host=HOST, to="home"),
        Transfer(robot_host=HOST, to="handover"),
        Transfer(robot_host=HOST, to="nail"),
    ]
)


def _executed(command: Move | Touch | Transfer, slow: SlowStation, q: Array) -> list[Trajectory]:
    """What an arm is given when the command is carried out; nothing where it is refused."""
    arm = ListeningArm(q)
    supervisor = Supervisor(arm, Bystander(), slow.robot, slow.config, lambda: slow.world)
    try:
        plan = command.plan(slow, q)
        if isinstance(command, Touch):
            arm.meets = 0.5
            approach(supervisor, slow, plan, TouchSettings(command.force or 1.0, 0.024, command.speed, None, 0.0, 12.0))
        else:
            supervisor.execute(plan)
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
def test_no_arguments_make_a_motion_faster_than_its_caps(
    command: Move | Touch, q: Array, caps: tuple[float, float]
) -> None:
    slow = SlowStation.of(STATION, Caps(*caps))
    for trajectory in _executed(command, slow, q):
        _assert_slow(trajectory, min(caps[0], 3.14), min(caps[1], STATION.arm.transfer_acceleration))


@examples(5)
@given(_transfers, _starts)
def test_no_transfer_is_faster_than_the_caps(command: Transfer, q: Array) -> None:
    slow = SlowStation.of(STATION, Caps())
    for trajectory in _executed(command, slow, q):
        _assert_slow(trajectory, SPEED, ACCELERATION)


@examples(30)
@given(st.integers(1, 6), st.floats(1e-3, 10.0), _caps)
def test_no_measurement_of_the_lag_is_faster_than_the_caps(joint: int, speed: float, caps: tuple[float, float]) -> None:
    slow = SlowStation.of(STATION, Caps(*caps))
    _assert_slow(lag_motion(HOME, joint, speed, slow.config.arm).trajectory, *caps)


@pytest.mark.parametrize(
    "command",
    [
        Move(robot_host=HOST, joint=3, by=0.05),
        Move(robot_host=HOST, along=(0.0, 0.0, 0.05), frame="pendant_base"),
        Move(robot_host=HOST, along=(0.0, 0.0, -0.02), frame="tool"),
        Touch(robot_host=HOST, along=(0.0, 0.0, -0.05), frame="base_link"),
        Transfer(robot_host=HOST, to="handover"),
        Transfer(robot_host=HOST, to="nail"),
        Transfer(robot_host=HOST, to="view"),
    ],
    ids=lambda command: f"{type(command).__name__} {getattr(command, 'to', '') or ''}",
)
def test_what_a_bring_up_asks_for_is_carried_out(command: Move | Touch | Transfer) -> None:
    given = _executed(command, SlowStation.of(STATION, Caps()), HOME)
    assert len(given) == (2 if isinstance(command, Touch) else 1)
    assert np.ptp(given[0].q, axis=0).max() > 0.01
    if isinstance(command, Touch):
        np.testing.assert_allclose(given[1].q[-1], given[0].q[0], atol=1e-6)


def test_a_touch_that_feels_contacts_where_nothing_presses_goes_on_and_gives_up_after_three() -> None:
    slow = SlowStation.of(STATION, Caps())
    arm = ListeningArm(HOME)
    arm.meets, arm.presses = 0.2, 1.0
    command = Touch(robot_host=HOST, along=(0.0, 0.0, -0.05), frame="base_link")
    supervisor = Supervisor(arm, Bystander(), slow.robot, slow.config, lambda: slow.world)
    with raises(DeviceError, code="device.force_noise"):
        approach(supervisor, slow, command.plan(slow, HOME), TouchSettings(8.0, 0.024, 0.01, None, 0.0, 12.0))
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
    command = Touch(robot_host=HOST, along=(0.0, 0.0, -0.05), frame="base_link")
    supervisor = Supervisor(arm, Bystander(), slow.robot, slow.config, lambda: slow.world)
    settings = TouchSettings(8.0, 0.024, 0.01, None, 0.0, 12.0)
    met: list[Contact] = []
    with raises(DeviceError, code="device.arm"):
        approach(supervisor, slow, command.plan(slow, HOME), settings, met=met.append)
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
    assert MotionOptions(robot_host=HOST).max_speed == SPEED
    assert MotionOptions(robot_host=HOST).max_acceleration == ACCELERATION
