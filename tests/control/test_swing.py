"""A swing: square and fast at the contact, turning back at once, within every limit, for any nail and offset."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.control.desk import TOOL
from tests.errors import raises
from tests.examples import examples
from toolee_robot.control import CollisionWorld, Mode, RobotModel, StrikePlan, check_trajectory
from toolee_robot.control.collision import BRAKE_EXEMPT, RUN_UP_EXEMPT
from toolee_robot.control.collision_shapes import box_body
from toolee_robot.control.limits import carried_speed
from toolee_robot.control.planning.swing import plan_swing
from toolee_robot.control.planning.swing_problem import SwingLimits
from toolee_robot.control.planning.swing_spline import Spline
from toolee_robot.control.supervisor_checks import check_limits, check_speed
from toolee_robot.errors import CollisionError, LimitError, PlanningError, UnreachableError, UserError
from toolee_robot.frames import Array, angle_between, transform
from toolee_robot.robots import SHADOW_HAND
from toolee_robot.station import StationConfig, sim_station
from toolee_robot.types import ArmModel, Payload

RATED = np.array([330.0, 330, 150, 56, 56, 56])
"""Of the UR10 and the UR10e [Nm], from their data sheets."""


def torques(robot: RobotModel, plan: StrikePlan, q_hand: Array, X_hand_ee: Array, tool: Payload = TOOL) -> Array:
    """Inverse dynamics of arm, hand with all its joints, and tool; largest of each arm joint (6,) [Nm]."""
    model = robot.model.copy()
    frame = model.frames[model.getFrameId(robot.description.hand_frame)]
    p = (X_hand_ee @ np.append(tool.center_of_mass, 1.0))[:3]
    inertia = pin.Inertia(tool.mass, np.zeros(3), np.zeros((3, 3)))
    model.appendBodyToJoint(frame.parentJoint, inertia, frame.placement * pin.SE3(np.eye(3), p))
    data, still = model.createData(), np.zeros(len(q_hand))
    arm = [model.joints[model.getJointId(name)].idx_v for name in robot.description.arm_joints]
    worst = np.zeros(6)
    for q, qd, qdd in zip(plan.strike.q, plan.strike.qd, plan.strike.qdd, strict=True):
        state = robot.configuration(q, q_hand), robot.configuration(qd, still), robot.configuration(qdd, still)
        worst = np.maximum(worst, np.abs(pin.rnea(model, data, *state)[arm]))
    return worst


def check_plan(
    robot: RobotModel, config: StationConfig, plan: StrikePlan, q_hand: Array, X_hand_ee: Array, X_base_nail: Array,
    limits: SwingLimits,
) -> None:  # fmt: skip
    """Everything that a swing promises, from the trajectory alone."""
    strike, world = plan.strike, CollisionWorld(robot, config, q_hand, X_hand_ee)
    for trajectory in (plan.approach, strike):
        check_trajectory(trajectory, robot.arm, config.arm, config.scene, world)
        check_limits(trajectory, robot, config, world)
    check_speed(strike, world, config.supervisor.unattended_speed, Mode.UNATTENDED)
    assert np.max(np.diff(strike.times)) <= 0.0041
    assert np.allclose(plan.approach.q[-1], strike.q[0], atol=1e-9)

    def face(t: float) -> Array:
        return robot.X_base_ee(strike.sample(t)[0], q_hand, X_hand_ee)

    axis, h, t = X_base_nail[:3, 2], 1e-4, plan.contact_time
    contact = face(t)
    assert np.allclose(contact, plan.X_base_ee_contact, atol=1e-6)
    assert np.linalg.norm(contact[:3, 3] - X_base_nail[:3, 3]) < 1e-5
    velocity = (face(t + h)[:3, 3] - face(t - h)[:3, 3]) / (2 * h)
    assert velocity @ axis == pytest.approx(plan.speed, rel=2e-3)
    assert np.linalg.norm(velocity - (velocity @ axis) * axis) < 0.005 + 0.005 * plan.speed
    # Square to 1 deg, also where the nail is higher or lower than believed.
    for early in (-limits.height_error, 0.0, limits.height_error):
        assert np.rad2deg(angle_between(face(t + early / plan.speed)[:3, 2], axis)) < 1.0
    depth = np.array([(face(s)[:3, 3] - X_base_nail[:3, 3]) @ axis for s in np.linspace(0, strike.duration, 200)])
    times = np.linspace(0, strike.duration, 200)
    assert np.all(depth[times < t] < 1e-5), "the face must come from above"
    assert np.max(depth) <= limits.deepest + 2e-5
    assert plan.brake_length == pytest.approx(max(np.max(depth), 0.0), abs=1e-3)
    if np.isfinite(limits.deepest):
        assert depth[-1] < limits.deepest - 0.03, "the command must turn back"
    assert np.all(torques(robot, plan, q_hand, X_hand_ee) <= limits.torque_share * RATED * 1.001)
    before = strike.times <= t
    assert world.closest(strike.q[before], 0.05, RUN_UP_EXEMPT).distance > 0.5 * config.strike.clearance
    assert world.closest(strike.q[~before], 0.05, BRAKE_EXEMPT).distance > 0.5 * config.strike.clearance


@pytest.mark.parametrize("model", [ArmModel.UR10, ArmModel.UR10E])
@given(
    x=st.floats(0.6, 0.9), y=st.floats(-0.2, 0.4), along=st.floats(-0.03, 0.03), about=st.floats(-25, 25),
    tilt=st.floats(-12, 12), deep=st.sampled_from([0.006, 0.010, 0.030, 0.100, np.inf]),
    speed=st.sampled_from([0.4, 0.8, 1.2, np.inf]), protrusion=st.floats(0.0, 0.045),
)  # fmt: skip
@examples(4)
def test_any_plan_keeps_every_promise(
    model: ArmModel, home: Array, X_tool_ee: Array, x: float, y: float, along: float, about: float, tilt: float,
    deep: float, speed: float, protrusion: float,
) -> None:  # fmt: skip
    config = sim_station()
    config = replace(config, arm=replace(config.arm, model=model), work=replace(config.work, nail_xy=(x, y)))
    robot, limits = RobotModel.of_station(config), SwingLimits(TOOL, deepest=deep)
    q_hand = robot.description.hand_closed
    turn = Rotation.from_euler("ZYX", [about, tilt, -tilt], degrees=True)
    X_hand_ee = SHADOW_HAND.grasp.X_hand_tool(0.016) @ transform(turn, [0, 0, along]) @ X_tool_ee
    X_base_nail = config.work.X_base_nail(protrusion)

    def plan() -> StrikePlan:
        world = CollisionWorld(robot, config, q_hand, X_hand_ee)
        return plan_swing(robot, config, world, home, q_hand, X_hand_ee, X_base_nail, speed=speed, limits=limits)

    try:
        first = plan()
    except PlanningError:
        return  # which of them are feasible, and that most are: test_most_nails_can_be_struck
    check_plan(robot, config, first, q_hand, X_hand_ee, X_base_nail, limits)
    assert first.speed <= min(speed, config.supervisor.unattended_speed) + 1e-6
    again = plan()
    assert np.array_equal(first.strike.q, again.strike.q)
    assert np.array_equal(first.strike.times, again.strike.times)


def test_most_nails_can_be_struck(robot: RobotModel, home: Array, q_hand: Array, X_hand_ee: Array) -> None:
    rng, base = np.random.default_rng(3), sim_station()
    speeds = []
    for _ in range(5):
        xy = (float(rng.uniform(0.7, 0.9)), float(rng.uniform(0.1, 0.4)))
        config = replace(base, work=replace(base.work, nail_xy=xy))
        world = CollisionWorld(robot, config, q_hand, X_hand_ee)
        nail = config.work.X_base_nail()
        speeds.append(
            plan_swing(
                robot, config, world, home, q_hand, X_hand_ee, nail, speed=np.inf, limits=SwingLimits(TOOL)
            ).speed
        )
    assert np.min(speeds) > 0.5


def test_a_deeper_turn_is_faster_and_the_stations_speed_ends_it(
    robot: RobotModel, config: StationConfig, world: CollisionWorld, home: Array, q_hand: Array, X_hand_ee: Array
) -> None:
    nail = config.work.X_base_nail()
    speeds = []
    for deepest in (0.005, 0.010, 0.030, np.inf):
        limits = SwingLimits(TOOL, deepest=deepest)
        plan = plan_swing(robot, config, world, home, q_hand, X_hand_ee, nail, speed=np.inf, limits=limits)
        speeds.append(plan.speed)
        assert np.max(carried_speed(plan.strike, world)) <= config.supervisor.unattended_speed * 1.001
    assert np.all(np.diff(speeds) > 0.1)
    assert speeds[-1] > 1.35


def test_a_speed_that_is_asked_for_is_met(
    robot: RobotModel, config: StationConfig, world: CollisionWorld, home: Array, q_hand: Array, X_hand_ee: Array
) -> None:
    nail = config.work.X_base_nail()
    plan = plan_swing(robot, config, world, home, q_hand, X_hand_ee, nail, speed=0.5, limits=SwingLimits(TOOL))
    assert plan.speed == pytest.approx(0.5, rel=0.02)
    assert plan.wanted_speed == 0.5


@pytest.mark.parametrize(
    ("xy", "limits", "error", "code"),
    [
        ((1.9, 0.0), SwingLimits(TOOL), UnreachableError, "unreachable.nail"),
        ((0.75, 0.1), SwingLimits(TOOL, torque_share=0.05), LimitError, "limit.swing"),
        ((0.75, 0.1), SwingLimits(TOOL, deepest=0.001), LimitError, "limit.swing"),
    ],
)
def test_an_infeasible_nail_is_refused(
    robot: RobotModel, config: StationConfig, home: Array, q_hand: Array, X_hand_ee: Array,
    xy: tuple[float, float], limits: SwingLimits, error: type[PlanningError], code: str,
) -> None:  # fmt: skip
    config = replace(config, work=replace(config.work, nail_xy=xy))
    world = CollisionWorld(robot, config, q_hand, X_hand_ee)
    with raises(error, code=code):
        plan_swing(robot, config, world, home, q_hand, X_hand_ee, config.work.X_base_nail(), limits=limits)


def test_a_wall_in_the_way_and_a_broken_pose_are_refused(
    robot: RobotModel, config: StationConfig, world: CollisionWorld, home: Array, q_hand: Array, X_hand_ee: Array
) -> None:
    x, y = config.work.nail_xy
    roof = box_body("shelf", (x, y, config.work.wood_height + 0.10), (0.5, 0.5, 0.02))
    walled, nail = CollisionWorld(robot, config, q_hand, X_hand_ee, extra=(roof,)), config.work.X_base_nail()
    with pytest.raises(CollisionError, match="shelf"):
        plan_swing(robot, config, walled, home, q_hand, X_hand_ee, nail, limits=SwingLimits(TOOL))
    with raises(UserError, code="user.not_rigid"):
        plan_swing(robot, config, world, home, q_hand, X_hand_ee * np.nan, nail, limits=SwingLimits(TOOL))
    for wrong in ((0.0, 0.9, 0.003), (0.01, 1.1, 0.003), (0.01, 0.9, -0.001), (np.nan, 0.9, 0.003)):
        with raises(UserError, code="user.swing_limits"):
            SwingLimits(TOOL, *wrong)


@given(x=st.lists(st.floats(-1, 1), min_size=10, max_size=10), u=st.floats(0, 1))
@examples(50)
def test_a_spline_rests_at_its_ends_passes_the_contact_and_moves_as_it_says(x: list[float], u: float) -> None:
    spline = Spline.build(0.03, 7, 5)
    assert spline.size == len(x)
    ends, at = np.array([0.0, 12 * 0.03]), np.array([0.005 + u * 0.35])
    for order in (1, 2):
        assert np.allclose(spline.at(ends, order) @ x, 0.0, atol=1e-9)
    assert np.allclose(spline.at(np.array([spline.contact_time])) @ x, 0.0, atol=1e-12)
    h = 1e-5
    for order in (0, 1):
        slope = (spline.at(at + h, order) - spline.at(at - h, order)) @ x / (2 * h)
        assert np.allclose(slope, spline.at(at, order + 1) @ x, rtol=1e-3, atol=1e-2 * 30**order)
    middle = 0.03 * np.arange(0.5, 12.0)
    jerk = (spline.at(middle + h, 2) - spline.at(middle - h, 2)) @ x / (2 * h)
    assert np.allclose(jerk, spline.jerk() @ x, rtol=1e-3, atol=1.0)
