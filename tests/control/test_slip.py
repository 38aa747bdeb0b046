"""Protrusion from a contact and slip between two looks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.control.test_strike import RATED, torques
from tests.errors import raises
from toolee_robot.control import CollisionWorld, RobotModel, StrikePlan, merge, plan_strike, protrusion, slip
from toolee_robot.control.arm_dynamics import StrikeLoad, strike_load
from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, transform
from toolee_robot.hal import MotionOutcome, MotionReport
from toolee_robot.robots import SHADOW_HAND
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel, InHandEstimate, JointState, Payload

SURE = np.eye(6) * 1e-6
VAGUE = np.diag([2e-3**2] * 3 + [0.04**2] * 3)


def estimate(X_hand_ee: Array, category: Category = Category.HAMMER_HEAD, covariance: Array = SURE) -> InHandEstimate:
    return InHandEstimate(category, X_hand_ee, covariance, 0.9, 5, 5, True, "ok")


@given(
    height=st.floats(-0.002, 0.03),
    aside=st.floats(-0.008, 0.008),
    tilt_deg=st.floats(-10, 10),
    spin=st.floats(-3.1, 3.1),
)
def test_protrusion_is_where_the_faces_plane_cuts_the_axis(
    height: float, aside: float, tilt_deg: float, spin: float
) -> None:
    work = sim_station().work
    X_base_nail = work.X_base_nail(height)
    # The face touches the head's centre with a point that is `aside` of its own centre.
    X_nail_ee = transform(Rotation.from_euler("zy", [spin, np.deg2rad(tilt_deg)])) @ transform(p=[aside, 0, 0])
    assert protrusion(X_base_nail @ X_nail_ee, work.X_base_nail(0.0)) == pytest.approx(height, abs=1e-9)


def test_a_face_turned_away_is_no_contact() -> None:
    work = sim_station().work
    upside_down = work.X_base_nail() @ transform(Rotation.from_euler("x", np.pi))
    with raises(UserError, code="user.face_direction"):
        protrusion(upside_down, work.X_base_nail(0.0))


@given(spin=st.floats(-3.1, 3.1), tilt=st.floats(0, 0.5), shift=st.floats(0, 0.05))
def test_slip_ignores_the_symmetric_spin(spin: float, tilt: float, shift: float) -> None:
    before = transform(Rotation.from_euler("xyz", [0.2, -1.0, 0.4]), [0.01, -0.02, 0.2])
    moved = before @ transform(Rotation.from_euler("xz", [tilt, spin]))
    moved[:3, 3] += [shift, 0, 0]
    distance, angle = slip(estimate(before), estimate(moved))
    assert distance == pytest.approx(shift, abs=1e-12)
    assert angle == pytest.approx(tilt, abs=1e-7)


def test_a_claw_has_no_free_spin_and_is_no_face() -> None:
    spun = transform(Rotation.from_euler("z", 0.3))
    _, angle = slip(estimate(np.eye(4), Category.HAMMER_GRIP), estimate(spun, Category.HAMMER_GRIP))
    assert angle == pytest.approx(0.3)
    with raises(UserError, code="user.different_categories"):
        slip(estimate(np.eye(4)), estimate(np.eye(4), Category.HAMMER_GRIP))


def test_equal_looks_meet_half_way_and_share_their_error() -> None:
    tilt = transform(Rotation.from_euler("y", 4, degrees=True), [0.004, 0, 0])
    merged = merge(estimate(np.eye(4), covariance=VAGUE), estimate(tilt, covariance=VAGUE), 0.0, 0.0)
    np.testing.assert_allclose(merged.X_hand_ee[:3, 3], [0.002, 0, 0], atol=1e-9)
    assert merged.category.symmetry.rotation_error(merged.X_hand_ee[:3, :3], np.eye(3)) == pytest.approx(np.deg2rad(2))
    np.testing.assert_allclose(merged.covariance, VAGUE)


def test_a_tool_that_slipped_further_than_it_drifts_is_where_the_new_look_says() -> None:
    slipped = estimate(transform(Rotation.from_euler("y", 12, degrees=True), [0.012, 0, 0]), covariance=VAGUE)
    assert merge(estimate(np.eye(4), covariance=VAGUE), slipped, 0.001, 0.005) is slipped


def test_after_much_drift_the_new_look_counts() -> None:
    moved = transform(p=[0.01, 0, 0])
    merged = merge(estimate(np.eye(4)), estimate(moved), 0.1, 0.1)
    np.testing.assert_allclose(merged.X_hand_ee[:3, 3], [0.01, 0, 0], atol=1e-5)


@given(spin=st.floats(-3.1, 3.1))
def test_the_free_spin_does_not_disturb_a_merge(spin: float) -> None:
    X = transform(Rotation.from_euler("xy", [20, 10], degrees=True), [0.2, 0, 0.1])
    merged = merge(estimate(X), estimate(X @ transform(Rotation.from_euler("z", spin))), 0.001, 0.01)
    np.testing.assert_allclose(merged.X_hand_ee[:3, 2], X[:3, 2], atol=1e-9)
    np.testing.assert_allclose(merged.X_hand_ee[:3, 3], X[:3, 3], atol=1e-9)


CONFIG = sim_station()


@pytest.fixture(scope="module")
def struck(X_tool_ee: Array, home: Array) -> tuple[RobotModel, StrikePlan, Array, Array, Payload]:
    robot = RobotModel.of_station(CONFIG)
    q_hand, tool = robot.description.hand_closed, Payload(1.05, np.array([0.06, 0.0, -0.05]))
    X_hand_ee = SHADOW_HAND.grasp.X_hand_tool(0.016) @ X_tool_ee
    world = CollisionWorld(robot, CONFIG, q_hand, X_hand_ee)
    plan = plan_strike(robot, CONFIG, world, home, q_hand, X_hand_ee, CONFIG.work.X_base_nail(), tool=tool)
    payload = robot.payload(q_hand, X_hand_ee, tool.mass, tool.center_of_mass)
    return robot, plan, q_hand, X_hand_ee, payload


def report_of(plan: StrikePlan, rate: float, jitter: float = 0.0) -> MotionReport:
    t = np.arange(0.0, plan.strike.duration + 0.1, 1 / rate)
    q = np.array([plan.strike.sample(min(s, plan.strike.duration))[0] for s in t])
    t = t + np.random.default_rng(0).uniform(0.0, jitter, len(t))
    contact = JointState(plan.q_contact, np.zeros(6), plan.contact_time)
    wrenches = np.zeros((len(t), 6))
    wrenches[(t > plan.contact_time) & (t < plan.contact_time + 0.02), 2] = 50.0
    return MotionReport(MotionOutcome.CONTACT, t, q, q, wrenches, contact)


@pytest.mark.parametrize("rate", [125.0, 500.0])
def test_a_strikes_torque_is_that_of_its_plan(
    struck: tuple[RobotModel, StrikePlan, Array, Array, Payload], rate: float
) -> None:
    """Against the inverse dynamics of the whole hand: as measured, with stamps that jitter by a millisecond."""
    robot, plan, q_hand, X_hand_ee, payload = struck
    report = report_of(plan, rate, jitter=0.001)
    load = strike_load(replace(report, wrenches=np.zeros_like(report.wrenches)), robot, q_hand, payload, ArmModel.UR10)
    expected = float(np.max(torques(robot, plan, q_hand, X_hand_ee) / RATED))
    assert load.torque_share == pytest.approx(expected, rel=0.08)
    assert 0.4 < expected < 1.0


def test_impulse_and_ratios_are_the_reports(struck: tuple[RobotModel, StrikePlan, Array, Array, Payload]) -> None:
    robot, plan, q_hand, _, payload = struck
    plain = report_of(plan, 500.0)
    ratios = np.linspace(0.0, 0.7, len(plain.stamps))
    report = replace(plain, position_deviation_ratios=ratios, collision_ratios=0.5 * ratios)
    load = strike_load(report, robot, q_hand, payload, ArmModel.UR10)
    assert load.impulse == pytest.approx(50.0 * 0.02, rel=0.15)
    assert load.position_deviation_ratio == pytest.approx(0.7)
    assert load.collision_ratio == pytest.approx(0.35)
    missed = strike_load(replace(plain, contact=None), robot, q_hand, payload, ArmModel.UR10)
    assert (missed.impulse, missed.position_deviation_ratio, missed.collision_ratio) == (0.0, None, None)


@pytest.mark.parametrize(
    ("load", "says"),
    [
        (StrikeLoad(3.0, 0.9), ""),
        (StrikeLoad(3.0, 0.9, 0.6, 0.6), ""),
        (StrikeLoad(3.0, 0.9, 0.61, 0.1), "position deviation"),
        (StrikeLoad(3.0, 0.9, float("nan"), 0.1), "position deviation"),
        (StrikeLoad(3.0, 0.9, 0.1, 0.99), "collision"),
        (StrikeLoad(3.0, 1.01, None, None), "torque"),
    ],
)
def test_no_strike_follows_one_that_nearly_stopped_the_robot(load: StrikeLoad, says: str) -> None:
    excess = load.excess(sim_station().strike)
    assert (says in excess) if says else not excess
    assert not says or "lower" in excess
