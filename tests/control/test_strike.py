"""A strike: square and fast at the contact, turning back at once, within every limit, for any nail and offset."""

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
from tests.examples import examples, seldom
from toolee_robot.control import (
    CollisionWorld,
    Mode,
    RobotModel,
    StrikePlan,
    check_trajectory,
    plan_over_nail,
    plan_straight,
    plan_strike,
    protrusion,
)
from toolee_robot.control.arm_dynamics import ArmDynamics
from toolee_robot.control.collision import BRAKE_EXEMPT, RUN_UP_EXEMPT
from toolee_robot.control.collision_shapes import box_body
from toolee_robot.control.limits import carried_speed
from toolee_robot.control.planning.swing_problem import HEIGHT_ERROR
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


def momenta(robot: RobotModel, plan: StrikePlan, q_hand: Array, X_hand_ee: Array) -> Array:
    """Momentum of arm, hand and tool between the samples, by the motion of their common centre of mass, (N,)."""
    dynamics = ArmDynamics(robot, q_hand, X_hand_ee, TOOL)
    model, data = dynamics.model, dynamics.model.createData()
    centre = np.stack([pin.centerOfMass(model, data, q).copy() for q in plan.strike.q])
    speed = np.linalg.norm(np.diff(centre, axis=0), axis=1) / np.diff(plan.strike.times)
    return np.asarray(pin.computeTotalMass(model) * speed)


def check_plan(
    robot: RobotModel, config: StationConfig, plan: StrikePlan, q_hand: Array, X_hand_ee: Array, X_base_nail: Array
) -> None:  # fmt: skip
    """Everything that a strike promises, from the trajectory alone."""
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
    for early in (-HEIGHT_ERROR, 0.0, HEIGHT_ERROR):
        assert np.rad2deg(angle_between(face(t + early / plan.speed)[:3, 2], axis)) < 1.0
    depth = np.array([(face(s)[:3, 3] - X_base_nail[:3, 3]) @ axis for s in np.linspace(0, strike.duration, 200)])
    times = np.linspace(0, strike.duration, 200)
    assert np.all(depth[times < t] < 1e-5), "the face must come from above"
    assert np.max(depth) <= config.strike.deepest + 2e-5
    assert plan.brake_length == pytest.approx(max(np.max(depth), 0.0), abs=1e-3)
    assert depth[-1] < config.strike.deepest - 0.03, "the command must turn back"
    # A tenth of the rated torques is left for friction and rotors, which the inverse dynamics do not have.
    assert np.all(torques(robot, plan, q_hand, X_hand_ee) <= 0.9 * RATED * 1.001)
    assert np.max(momenta(robot, plan, q_hand, X_hand_ee)) < config.supervisor.momentum
    before = strike.times <= t
    assert world.closest(strike.q[before], 0.05, RUN_UP_EXEMPT).distance > 0.5 * config.strike.clearance
    assert world.closest(strike.q[~before], 0.05, BRAKE_EXEMPT).distance > 0.5 * config.strike.clearance


@pytest.mark.parametrize("model", seldom(ArmModel.UR10, ArmModel.UR10E))
@given(
    x=st.floats(0.6, 0.9), y=st.floats(-0.2, 0.4), along=st.floats(-0.03, 0.03), about=st.floats(-25, 25),
    tilt=st.floats(-12, 12), deep=st.sampled_from([0.006, 0.010, 0.020, 0.100]),
    speed=st.sampled_from([0.4, 0.8, 1.2, np.inf]), protrusion=st.floats(0.0, 0.045),
)  # fmt: skip
@examples(4)
def test_any_plan_keeps_every_promise(
    model: ArmModel, home: Array, X_tool_ee: Array, x: float, y: float, along: float, about: float, tilt: float,
    deep: float, speed: float, protrusion: float,
) -> None:  # fmt: skip
    config = sim_station()
    config = replace(config, arm=replace(config.arm, model=model), work=replace(config.work, nail_xy=(x, y)))
    config = replace(config, strike=replace(config.strike, deepest=deep))
    robot = RobotModel.of_station(config)
    q_hand = robot.description.hand_closed
    turn = Rotation.from_euler("ZYX", [about, tilt, -tilt], degrees=True)
    X_hand_ee = SHADOW_HAND.grasp.X_hand_tool(0.016) @ transform(turn, [0, 0, along]) @ X_tool_ee
    X_base_nail = config.work.X_base_nail(protrusion)

    def plan() -> StrikePlan:
        world = CollisionWorld(robot, config, q_hand, X_hand_ee)
        return plan_strike(robot, config, world, home, q_hand, X_hand_ee, X_base_nail, tool=TOOL, speed=speed)

    try:
        first = plan()
    except PlanningError:
        return  # which of them are feasible, and that most are: test_most_nails_can_be_struck
    check_plan(robot, config, first, q_hand, X_hand_ee, X_base_nail)
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
        plan = plan_strike(robot, config, world, home, q_hand, X_hand_ee, nail, tool=TOOL, speed=np.inf)
        speeds.append(plan.speed)
    assert np.min(speeds) > 0.75


def test_a_deeper_turn_is_faster_and_the_stations_speed_ends_it(
    robot: RobotModel, config: StationConfig, world: CollisionWorld, home: Array, q_hand: Array, X_hand_ee: Array
) -> None:
    nail = config.work.X_base_nail()
    speeds = []
    for deepest in (0.005, 0.010, 0.030, 0.150):
        deep = replace(config, strike=replace(config.strike, deepest=deepest))
        plan = plan_strike(robot, deep, world, home, q_hand, X_hand_ee, nail, tool=TOOL, speed=np.inf)
        speeds.append(plan.speed)
        assert np.max(carried_speed(plan.strike, world)) <= config.supervisor.unattended_speed * 1.001
    assert np.all(np.diff(speeds) > 0.1)
    assert speeds[-1] > 1.35


@pytest.mark.parametrize(
    ("xy", "mass", "deepest", "error", "code"),
    [
        ((1.9, 0.0), 0.7, 0.020, UnreachableError, "unreachable.nail"),
        ((0.75, 0.1), 30.0, 0.020, LimitError, "limit.swing"),
        ((0.75, 0.1), 0.7, 0.001, LimitError, "limit.swing"),
    ],
)
def test_an_infeasible_nail_is_refused(
    robot: RobotModel, config: StationConfig, home: Array, q_hand: Array, X_hand_ee: Array,
    xy: tuple[float, float], mass: float, deepest: float, error: type[PlanningError], code: str,
) -> None:  # fmt: skip
    strike, tool = replace(config.strike, deepest=deepest), replace(TOOL, mass=mass)
    config = replace(config, work=replace(config.work, nail_xy=xy), strike=strike)
    world = CollisionWorld(robot, config, q_hand, X_hand_ee)
    with raises(error, code=code):
        plan_strike(robot, config, world, home, q_hand, X_hand_ee, config.work.X_base_nail(), tool=tool)


def test_a_lower_limit_of_the_momentum_makes_a_slower_strike(
    robot: RobotModel, config: StationConfig, world: CollisionWorld, home: Array, q_hand: Array, X_hand_ee: Array
) -> None:
    nail = config.work.X_base_nail()

    def speed(momentum: float) -> float:
        slow = replace(config, supervisor=replace(config.supervisor, momentum=momentum))
        plan = plan_strike(robot, slow, world, home, q_hand, X_hand_ee, nail, tool=TOOL)
        assert np.max(momenta(robot, plan, q_hand, X_hand_ee)) < momentum
        return plan.speed

    assert speed(8.0) < 0.95 * speed(100.0)


def test_each_joint_keeps_its_own_acceleration_and_a_gentle_strike_is_planned_too(
    robot: RobotModel, config: StationConfig, world: CollisionWorld, home: Array, q_hand: Array, X_hand_ee: Array
) -> None:
    nail, limits = config.work.X_base_nail(), (5.0, 5.0, 8.0, 15.0, 15.0, 12.0)
    uneven = replace(config, arm=replace(config.arm, acceleration=limits))
    plan = plan_strike(robot, uneven, world, home, q_hand, X_hand_ee, nail, tool=TOOL)
    check_plan(robot, uneven, plan, q_hand, X_hand_ee, nail)
    assert np.all(np.max(np.abs(plan.strike.qdd), axis=0) <= np.array(limits) * 1.001)
    gentle = plan_strike(robot, config, world, home, q_hand, X_hand_ee, nail, tool=TOOL, speed=0.25)
    assert gentle.speed == pytest.approx(0.25, rel=0.02)


def test_a_wall_in_the_way_and_a_broken_pose_are_refused(
    robot: RobotModel, config: StationConfig, world: CollisionWorld, home: Array, q_hand: Array, X_hand_ee: Array
) -> None:
    x, y = config.work.nail_xy
    roof = box_body("shelf", (x, y, config.work.wood_height + 0.10), (0.5, 0.5, 0.02))
    walled, nail = CollisionWorld(robot, config, q_hand, X_hand_ee, extra=(roof,)), config.work.X_base_nail()
    with pytest.raises(CollisionError, match="shelf"):
        plan_strike(robot, config, walled, home, q_hand, X_hand_ee, nail, tool=TOOL)
    with raises(UserError, code="user.not_rigid"):
        plan_strike(robot, config, world, home, q_hand, X_hand_ee * np.nan, nail, tool=TOOL)


def offset(along: float, about_deg: float, tilt_deg: float) -> Array:
    """A slip of the tool in the hand: along the handle [m], about it, and a tilt about both other axes [deg]."""
    return transform(Rotation.from_euler("ZYX", [about_deg, tilt_deg, -tilt_deg], degrees=True), [0, 0, along])


@pytest.mark.nightly
def test_where_the_arm_cannot_pass_itself_another_branch_is_struck_with(
    robot: RobotModel, config: StationConfig, q_hand: Array
) -> None:
    """From the last view of seed 7718 no way leads to the best four strikes, past the hand's forearm."""
    q_view = np.array([-0.3297, -1.3637, 2.1539, -2.1609, 2.0606, 0.8363])
    X_hand_ee = transform(Rotation.from_rotvec([0.1791, -0.4172, 3.0556]), [0.2022, -0.0438, 0.0943])
    world = CollisionWorld(robot, config, q_hand, X_hand_ee)
    plan = plan_strike(robot, config, world, q_view, q_hand, X_hand_ee, config.work.X_base_nail(), tool=TOOL)
    np.testing.assert_allclose(plan.approach.q[[0, -1]], [q_view, plan.q_standoff], atol=1e-9)
    assert plan.speed > 0.75


def faces(robot: RobotModel, q: Array, q_hand: Array, X_hand_ee: Array) -> Array:
    """X_base_ee (N, 4, 4)"""
    return np.stack([robot.X_base_ee(row, q_hand, X_hand_ee) for row in q])


@pytest.mark.nightly
def test_offsets_of_the_whole_range_are_planned(
    robot: RobotModel, config: StationConfig, home: Array, q_hand: Array, X_tool_ee: Array
) -> None:
    rng = np.random.default_rng(7)
    speeds = []
    corners = [(a, b, t) for a in (-0.03, 0.03) for b in (-25.0, 25.0) for t in (-12.0, 12.0)]
    draws = [(rng.uniform(-0.03, 0.03), rng.uniform(-25, 25), rng.uniform(-12, 12)) for _ in range(4)]
    for draw in corners + draws:
        X_hand_ee = SHADOW_HAND.grasp.X_hand_tool(0.016) @ offset(*draw) @ X_tool_ee
        world = CollisionWorld(robot, config, q_hand, X_hand_ee)
        X_base_nail = config.work.X_base_nail(rng.uniform(0, 0.02))
        plan = plan_strike(robot, config, world, home, q_hand, X_hand_ee, X_base_nail, tool=TOOL)
        assert np.allclose(plan.X_base_ee_contact[:3, 2:], X_base_nail[:3, 2:], atol=1e-6)
        speeds.append(plan.speed)
    assert np.min(speeds) >= 0.8


def test_touch_is_slow_straight_and_measures_the_protrusion(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    home: Array,
    q_hand: Array,
    X_hand_ee: Array,
    plan: StrikePlan,
) -> None:
    over = plan_over_nail(robot, config, world, home, plan, before=0.03)
    wood, nominal = config.work.X_base_nail(0.0), config.work.nail_protrusion
    above = faces(robot, over.q[-1:], q_hand, X_hand_ee)[0]
    assert protrusion(above, wood) == pytest.approx(nominal + 0.03, abs=1e-6)
    assert np.linalg.norm((above[:3, 3] - wood[:3, 3])[:2]) < 1e-6
    touch = plan_straight(robot, config, world, over.q[-1], -0.042, speed=config.strike.touch_speed)
    X = faces(robot, touch.q, q_hand, X_hand_ee)
    assert np.max(np.abs(np.gradient(X[:, 2, 3], touch.times))) <= config.strike.touch_speed * 1.01
    assert protrusion(X[-1], wood) == pytest.approx(nominal - 0.012, abs=1e-6)
    # And away again, from wherever it met the nail.
    up = plan_straight(robot, config, world, touch.q[len(X) // 2], 0.15)
    X_up = faces(robot, up.q, q_hand, X_hand_ee)
    assert X_up[-1, 2, 3] - X_up[0, 2, 3] == pytest.approx(0.15, abs=1e-6)
    assert np.max(np.linalg.norm(X_up[:, :2, 3] - X_up[0, :2, 3], axis=-1)) < 1e-6
