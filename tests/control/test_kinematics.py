"""Forward kinematics agree between Pinocchio, the batch and the description; inverse kinematics find every branch."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.errors import raises
from tests.examples import examples
from toolee_robot.control import RobotModel
from toolee_robot.control.planning.straight import Line
from toolee_robot.errors import UnreachableError
from toolee_robot.frames import Array, inverse, transform

angles = arrays(np.float64, (6,), elements=st.floats(-3.1, 3.1))


def turns_apart(a: Array, b: Array) -> Array:
    return np.abs(np.mod(a - b + np.pi, 2 * np.pi) - np.pi)


@given(q=angles)
@examples(30)
def test_batch_agrees_with_pinocchio_and_with_the_description(robot: RobotModel, q_hand: Array, q: Array) -> None:
    X_base_flange, X_base_hand = robot.fk(q, q_hand)
    assert np.allclose(robot.arm.fk(q), X_base_flange, atol=1e-12)
    links = robot.description.link_poses(q, q_hand)
    assert np.allclose(links[robot.description.flange_frame], X_base_flange, atol=1e-9)
    assert np.allclose(links[robot.description.hand_frame], X_base_hand, atol=1e-9)
    assert np.allclose(X_base_flange @ robot.X_flange_hand(q_hand), X_base_hand, atol=1e-12)


@given(q=angles)
@examples(30)
def test_jacobian_is_the_derivative_of_fk(robot: RobotModel, q: Array) -> None:
    h = 1e-6
    X, J = robot.arm.fk_jacobian(q)
    ahead, behind = robot.arm.fk(q + h * np.eye(6)), robot.arm.fk(q - h * np.eye(6))
    assert np.allclose((ahead - behind)[:, :3, 3].T / (2 * h), J[:3], atol=1e-7)
    spin = (ahead - behind)[:, :3, :3] / (2 * h) @ X[:3, :3].T
    assert np.allclose(np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]]), J[3:], atol=1e-7)


@given(q=angles)
@examples(100)
def test_every_branch_reaches_the_pose_and_one_is_the_original(robot: RobotModel, q: Array) -> None:
    X, J = robot.arm.fk_jacobian(q)
    assume(np.linalg.svd(J, compute_uv=False)[-1] > 1e-2)
    found = robot.ik.branches(X)
    found = found[np.all(np.isfinite(found), axis=-1)]
    assert len(found) >= 2
    assert np.max(np.abs(robot.arm.fk(found) - X)) < 1e-9
    assert np.min(np.max(turns_apart(found, q), axis=-1)) < 1e-7
    for i in range(len(found)):
        for j in range(i):
            assert np.max(turns_apart(found[i], found[j])) > 1e-3, "two branches are one"


def test_solutions_are_inside_the_limits_and_nearest_first(robot: RobotModel, home: Array) -> None:
    solutions = robot.ik.solve(robot.arm.fk(home), near=home)
    assert np.allclose(solutions[0], home, atol=1e-9)
    for q in solutions:
        assert np.all(q >= robot.arm.lower)
        assert np.all(q <= robot.arm.upper)


def test_out_of_reach_says_so(robot: RobotModel) -> None:
    with pytest.raises(UnreachableError, match=r"2\.00 m from the base"):
        robot.ik.solve(transform(p=[2.0, 0.0, 0.1]))


def test_wrist_joints_move_the_hand_frame(robot: RobotModel, q_hand: Array) -> None:
    turned = q_hand.copy()
    turned[robot.description.hand.wrist_index[-1]] += 0.2
    change = inverse(robot.X_flange_hand(q_hand)) @ robot.X_flange_hand(turned)
    assert np.arccos((np.trace(change[:3, :3]) - 1) / 2) == pytest.approx(0.2, abs=1e-9)


def test_payload_adds_the_tool_to_the_hand(robot: RobotModel, q_hand: Array, X_hand_ee: Array) -> None:
    payload = robot.payload(q_hand, X_hand_ee, 0.8, np.zeros(3))
    hand = robot.description.hand_payload(q_hand)
    assert payload.mass == pytest.approx(hand.mass + 0.8)
    p_tool = (robot.X_flange_hand(q_hand) @ X_hand_ee)[:3, 3]
    share = 0.8 / payload.mass
    assert np.allclose(payload.center_of_mass, (1 - share) * hand.center_of_mass + share * p_tool)


def test_a_line_that_leaves_the_workspace_says_where(robot: RobotModel) -> None:
    line = Line.through(robot.ik, np.array([0.3, -1.1, 0.9, -0.4, 0.7, 0.2]), np.array([1.0, 0.0, 0.0]))
    with raises(UnreachableError, code="unreachable.line") as raised:
        line.q(np.linspace(0.0, 2.0, 50))
    assert "from s = 0" in str(raised.value)
