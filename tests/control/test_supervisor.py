"""The supervisor lets safe motions through as they are, and refuses every other one before anything moves."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tests.control.desk import GUARD, Desk, refused
from tests.errors import raises
from toolee_robot.control import (
    CollisionWorld,
    Meeting,
    Mode,
    RobotModel,
    StrikePlan,
    Supervisor,
    plan_transfer,
    slowed_to,
)
from toolee_robot.control.collision_shapes import box_body
from toolee_robot.control.limits import carried_speed
from toolee_robot.control.motion.trajectory_checks import START_TOLERANCE
from toolee_robot.control.planning.straight import Line
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.errors import (
    CollisionError,
    DeviceError,
    LatchedError,
    LimitError,
    NotReadyError,
    PersonNearError,
    ProtectiveStopError,
    StaleDataError,
)
from toolee_robot.frames import Array
from toolee_robot.hal import Arm, ArmStatus, MotionOutcome
from toolee_robot.station import StationConfig, SupervisorConfig
from toolee_robot.types import Trajectory

# -- what passes -------------------------------------------------------------------------------------------------


def test_it_is_an_arm_and_a_good_motion_passes_unchanged(desk: Desk) -> None:
    assert isinstance(desk.supervisor, Arm)
    move = desk.slow()
    with desk.supervisor as arm:
        report = arm.execute(move)
    assert report.outcome is MotionOutcome.COMPLETED
    assert np.allclose(desk.arm.q, move.q[-1])
    watch, wanted = desk.arm.watches[0], desk.config.supervisor
    assert watch is not None
    assert (watch.tracking_error, watch.data_cycles, watch.overruns) == (
        wanted.tracking_error,
        wanted.data_cycles,
        wanted.overruns,
    )


def test_what_the_robot_would_stop_for_its_momentum_is_refused(desk: Desk, robot: RobotModel) -> None:
    careful = replace(desk.config, supervisor=replace(desk.config.supervisor, momentum=1.0))
    supervisor = Supervisor(desk.arm, desk.person, robot, careful, lambda: desk.world)
    refused(desk, LimitError, lambda: supervisor.execute(desk.slow()), "limit.momentum")


def test_a_strike_passes_as_planned_once_it_is_permitted(desk: Desk, plan: StrikePlan) -> None:
    desk.ready_to_swing(plan)
    desk.arm.meets = plan.contact_time / plan.strike.duration
    report, verdict = desk.supervisor.swing(plan.strike, GUARD, plan.expected_contact)
    assert report.outcome is MotionOutcome.CONTACT
    assert verdict.meeting is Meeting.EXPECTED
    assert abs(verdict.before) < 0.011, "a cycle of 8 ms at 1.2 m/s"
    k = np.arange(1, 20)
    np.testing.assert_allclose(np.array(desk.arm.driven)[k - 1], [plan.strike.sample(i / 125)[0] for i in k])


# -- what does not ---------------------------------------------------------------------------------------------


def _spoil(name: str, row: int, joint: int, value: float) -> Callable[[Trajectory], Trajectory]:
    def change(t: Trajectory) -> Trajectory:
        x = getattr(t, name).copy()
        x[row, joint] += value
        return replace(t, **{name: x})

    return change


def _from(name: str, row: int, value: float) -> Callable[[Trajectory], Trajectory]:
    def change(t: Trajectory) -> Trajectory:
        x = getattr(t, name).copy()
        x[row:, 3] += value
        return replace(t, **{name: x})

    return change


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (_from("q", 40, 0.0005), "step_in_position"),
        (_from("q", 40, 0.3), "velocity_between_samples"),
        (_spoil("qd", 40, 3, 0.01), "step_in_position"),
        (_spoil("qd", 0, 3, 0.2), "not_at_rest"),
        (_from("qd", 40, 0.1), "not_at_rest"),
        (_spoil("qdd", 40, 3, 3.0), "jerk"),
        (_spoil("qdd", -1, 3, 3.0), "jerk"),
        (_spoil("qdd", 40, 3, 30.0), "acceleration"),
        (lambda t: replace(t, times=t.times / 30, qd=t.qd * 30, qdd=t.qdd * 900), "velocity"),
        (lambda t: replace(t, q=t.q + 0.02), "start"),
        (lambda t: replace(t, q=t.q + np.array([0.2, 0, 0, 0, 0, 0])), "start"),
        (lambda t: replace(t, q=t.q + np.array([0, 0, 3.0, 0, 0, 0])), "position"),
        (lambda t: replace(t, q=t.q[:, :5], qd=t.qd[:, :5], qdd=t.qdd[:, :5]), "joint_count"),
    ],
)
def test_what_breaks_a_limit_is_refused(desk: Desk, change: Callable[[Trajectory], Trajectory], cause: str) -> None:
    desk.supervisor.execute(desk.slow(0.1))
    refused(desk, LimitError, lambda: desk.supervisor.execute(change(desk.slow())), f"limit.{cause}")
    desk.supervisor.execute(desk.slow())  # it was the change, nothing else


@pytest.mark.parametrize(
    "change", [_spoil("q", 9, 2, np.nan), _spoil("qd", -1, 0, np.inf), _spoil("qdd", 0, 5, -np.inf)]
)
def test_values_that_are_not_finite_latch(desk: Desk, change: Callable[[Trajectory], Trajectory]) -> None:
    with raises(LimitError, code="limit.not_finite"):
        desk.supervisor.execute(change(desk.slow()))
    assert not desk.arm.driven
    refused(desk, LatchedError, lambda: desk.supervisor.execute(desk.slow()), "latched")
    desk.supervisor.reset(confirmed=True)
    desk.supervisor.execute(desk.slow())


def test_hand_and_tool_stay_within_the_workspace(
    robot: RobotModel, config: StationConfig, home: Array, q_hand: Array, X_hand_ee: Array
) -> None:
    """The tool hangs below the flange: a floor between the two stops it, and without the tool the hand."""

    def at_home(floor: float, held: Array | None) -> Desk:
        low = replace(config, scene=replace(config.scene, workspace_lower=(-1.0, -1.2, floor)))
        return Desk(robot, low, CollisionWorld(robot, low, q_hand, held), home)

    def lowest(held: Array | None) -> float:
        R, p = robot.arm.joints(home)
        return min(float((b.points @ R[5].T + p[5])[:, 2].min()) for b in at_home(0.05, held).world.carried)

    tool, hand, flange = lowest(X_hand_ee), lowest(None), float(robot.arm.fk(home)[2, 3])
    assert tool < hand - 0.02
    assert hand < flange - 0.1
    for floor, held in ((0.5 * (tool + hand), X_hand_ee), (0.5 * (hand + flange), None)):
        desk = at_home(floor, held)
        move = desk.slow()
        refused(desk, LimitError, partial(desk.supervisor.execute, move), "limit.carried_position")
    desk = at_home(tool - 0.001, X_hand_ee)
    desk.supervisor.execute(desk.slow(0.05))


@pytest.mark.parametrize(("outside", "code"), [(0.01, None), (0.04, "limit.carried_position")])
def test_a_tool_that_a_look_finds_slightly_outside_the_workspace_may_come_in_and_go_no_farther_out(
    robot: RobotModel, config: StationConfig, home: Array, q_hand: Array, X_hand_ee: Array,
    outside: float, code: str | None,
) -> None:  # fmt: skip
    R, p = robot.arm.joints(home)
    free = CollisionWorld(robot, config, q_hand, X_hand_ee)
    lowest = min(float((b.points @ R[5].T + p[5])[:, 2].min()) for b in free.carried)
    low = replace(config, scene=replace(config.scene, workspace_lower=(-1.0, -1.2, lowest + outside)))
    world = CollisionWorld(robot, low, q_hand, X_hand_ee)
    up, down = (home + np.array([0.4, change, 0.0, 0.0, 0.0, 0.0]) for change in (-0.3, 0.02))
    with nullcontext() if code is None else raises(LimitError, code=code):
        way = plan_transfer(robot, low, world, home, up)
        Desk(robot, low, world, home).supervisor.execute(slowed_to(way, world, 0.25))
    with raises(LimitError, code="limit.carried_position"):
        plan_transfer(robot, low, world, home, down)


def test_handover_is_slow_and_unattended_is_fast_but_not_any_fast(desk: Desk) -> None:
    fast = desk.move(0.5, speed=0.9)
    speed = float(np.max(carried_speed(fast, desk.world)))
    assert 0.3 < speed < 1.5
    refused(desk, LimitError, lambda: desk.supervisor.execute(fast), "limit.speed")
    slow = slowed_to(fast, desk.world, 0.25)
    assert slow.duration == pytest.approx(fast.duration * speed / (0.99 * 0.25))
    assert slowed_to(fast, desk.world, 2.0) is fast
    desk.supervisor.execute(slow)
    desk.supervisor.mode = Mode.UNATTENDED
    desk.supervisor.execute(desk.move(-0.5, speed=0.9))
    faster = desk.move(0.9, speed=2.0)
    faster = slowed_to(faster, desk.world, 0.7)
    gentle = replace(desk.config.strike, speed=0.5)
    tight = replace(desk.config, strike=gentle, supervisor=SupervisorConfig(unattended_speed=0.6))
    other = Supervisor(desk.arm, desk.person, desk.world.robot, tight, lambda: desk.world)
    other.mode = Mode.UNATTENDED
    refused(desk, LimitError, lambda: other.execute(faster), "limit.speed")


def test_a_way_through_something_is_refused_though_its_ends_are_free(
    desk: Desk, robot: RobotModel, config: StationConfig, q_hand: Array, X_hand_ee: Array
) -> None:
    free, move = desk.world, desk.slow(0.9)
    middle = robot.X_base_ee(move.sample(0.5 * move.duration)[0], q_hand, X_hand_ee)[:3, 3]
    post = box_body("post", tuple(middle), (0.03, 0.03, 0.03))
    desk.world = CollisionWorld(robot, config, q_hand, X_hand_ee, extra=(post,))
    refused(desk, CollisionError, lambda: desk.supervisor.execute(move), "collision.motion")
    refused(desk, CollisionError, lambda: desk.supervisor.execute(move, at_work=True), "collision.motion")
    desk.world = free  # the task says what holds now
    desk.supervisor.execute(move)


def test_only_the_tool_and_only_at_work_may_touch_the_block(desk: Desk, plan: StrikePlan) -> None:
    desk.supervisor.mode = Mode.UNATTENDED
    line = Line.through(desk.world.robot.ik, plan.q_contact, plan.X_base_ee_contact[:3, 2])
    start, end = line.q(np.array([-0.05, 0.06]))
    into = joint_move(start, end, np.full(6, 0.2), np.full(6, 3.0), np.full(6, 30.0))
    desk.arm.q = into.q[0].copy()
    refused(desk, CollisionError, lambda: desk.supervisor.execute(into), "collision.motion")
    desk.supervisor.execute(into, at_work=True)


def test_an_arm_that_is_not_ready_not_known_or_elsewhere_is_not_moved(desk: Desk) -> None:
    move = desk.slow()
    desk.arm.fresh = False
    refused(desk, StaleDataError, lambda: desk.supervisor.execute(move), "stale_data")
    desk.arm.fresh = True
    for status in ArmStatus:
        desk.arm.status = status
        if status is not ArmStatus.READY:
            refused(desk, NotReadyError, lambda: desk.supervisor.execute(move), "not_ready.status")
    desk.arm.status = ArmStatus.READY
    desk.arm.measured_off = np.array([0, 0.05, 0, 0, 0, 0])
    refused(desk, LimitError, lambda: desk.supervisor.execute(move), "limit.off_command")
    # Nor from where it has been moved to: it would jump there from where it holds itself.
    there = slowed_to(replace(move, q=move.q + desk.arm.measured_off), desk.world, 0.2)
    refused(desk, LimitError, lambda: desk.supervisor.execute(there), "limit.off_command")


@pytest.mark.parametrize("moved_before", [False, True], ids=["first", "second"])
@pytest.mark.parametrize("off", [2 * START_TOLERANCE, 1e-4, 0.009, 0.015625])
def test_a_motion_starts_at_the_command_and_not_beside_it(desk: Desk, off: float, moved_before: bool) -> None:
    """Where the arm's joints are measured, a servo's lag or a load away from it, is beside it, too."""
    if moved_before:
        desk.supervisor.execute(desk.slow(0.1))
    move, there = desk.slow(), np.array([0, off, 0, 0, 0, 0])
    desk.arm.measured_off = there
    refused(desk, LimitError, lambda: desk.supervisor.execute(replace(move, q=move.q + there)), "limit.start")
    desk.supervisor.execute(replace(move, q=move.q + 0.5 * START_TOLERANCE))


def test_the_force_is_zeroed_at_standstill_and_not_while_latched(desk: Desk) -> None:
    desk.supervisor.zero_wrench()
    assert desk.arm.zeroed == 1
    desk.arm.status = ArmStatus.PROTECTIVE_STOP
    refused(desk, NotReadyError, desk.supervisor.zero_wrench, "not_ready.status")
    desk.arm.status = ArmStatus.READY
    desk.arm.fault = ProtectiveStopError
    with pytest.raises(ProtectiveStopError):
        desk.supervisor.execute(desk.slow())
    with raises(LatchedError, code="latched"):
        desk.supervisor.zero_wrench()
    assert desk.arm.zeroed == 1


def test_an_arm_that_cannot_be_moved_by_hand_says_so(desk: Desk) -> None:
    with raises(DeviceError, code="device.no_freedrive"), desk.supervisor.freedrive():
        pass
    desk.supervisor.mode = Mode.UNATTENDED
    with raises(PersonNearError, code="person_near.freedrive"), desk.supervisor.freedrive():
        pass
