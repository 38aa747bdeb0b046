"""The controller's kinematics, against themselves and against the arm's URDF."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from tests.strategies import transforms
from toolee_robot.frames import Array
from toolee_robot.robots import load_robot
from toolee_robot.sim_backend.ur_controller.robot import poses
from toolee_robot.sim_backend.ur_controller.robot.kinematics import chain, forward, inverse, inverse_all
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS, UR10, UR10E, ControllerModel
from toolee_robot.types import ArmModel

models = st.sampled_from([UR10, UR10E])
angle = st.floats(-6.2, 6.2)
joints = st.tuples(*[angle] * 6).map(np.array)


@given(models, joints)
@examples(200)
def test_every_posture_found_is_at_the_pose(model: ControllerModel, q: Array) -> None:
    X = forward(model, q)
    found = inverse_all(model, X, q)
    assert found
    for posture in found:
        np.testing.assert_allclose(forward(model, posture), X, atol=1e-7)
        assert np.all(np.abs(posture) <= model.position)


@given(models, joints)
@examples(200)
def test_the_posture_itself_is_found_from_nearby(model: ControllerModel, q: Array) -> None:
    if abs(np.sin(q[4])) < 0.05 or abs(np.sin(q[2])) < 0.05 or _over_the_base(model, q):
        return  # at a singularity the nearest posture need not be the same one
    found = inverse(model, forward(model, q), q + 1e-3)
    assert found is not None
    np.testing.assert_allclose(np.array(found), q, atol=1e-8)


def _over_the_base(model: ControllerModel, q: Array) -> bool:
    wrist = chain(model, q).origins[5]
    return bool(np.hypot(*wrist[:2]) < 1.05 * model.d[3])


@given(models, transforms(), joints)
@examples(100)
def test_what_is_reached_is_reached_and_what_is_not_is_none(model: ControllerModel, X: Array, near: Array) -> None:
    X = X.copy()
    X[:3, 3] *= 2.0
    found = inverse(model, X, near)
    if found is not None:
        np.testing.assert_allclose(forward(model, found), X, atol=1e-7)
    else:
        assert not inverse_all(model, X, near)
    X[:3, 3] = [0.0, 0.0, 3.0]
    assert inverse(model, X, near) is None


@given(models, joints)
@examples(50)
def test_the_jacobian_is_the_derivative(model: ControllerModel, q: Array) -> None:
    h = 1e-6
    J = chain(model, q).jacobian(forward(model, q)[:3, 3])
    for i in range(6):
        step = np.zeros(6)
        step[i] = h
        twist = poses.difference(forward(model, q - step), forward(model, q + step)) / (2 * h)
        np.testing.assert_allclose(J[:, i], twist, atol=1e-8)


@pytest.mark.parametrize("name", sorted(MODELS))
def test_the_models_agree_with_the_urdf_turned_by_half_a_turn(name: str) -> None:
    robot = load_robot(ArmModel[name.upper()])
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    rng = np.random.default_rng(7)
    for _ in range(20):
        q = rng.uniform(-3, 3, 6)
        X_urdf = robot.link_poses(q, robot.hand_open)[robot.flange_frame]
        np.testing.assert_allclose(forward(MODELS[name], q), turn @ X_urdf, atol=2e-5)


@given(transforms(), transforms())
@examples(100)
def test_poses_and_displacements_invert_each_other(X: Array, Y: Array) -> None:
    np.testing.assert_allclose(poses.matrix(poses.vector(X)), X, atol=1e-9)
    np.testing.assert_allclose(poses.moved(X, poses.difference(X, Y)), Y, atol=1e-9)
