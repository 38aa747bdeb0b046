"""The arm weighs what its maker says: planner and controller see the same torques of an arm at rest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control.arm_dynamics import ArmDynamics
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.robots.description import arm_tree
from toolee_robot.sim_backend.ur_controller.robot.collision_detection import UPRIGHT
from toolee_robot.sim_backend.ur_controller.robot.collision_detection import ArmDynamics as ControllerDynamics
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.types import ArmModel, Payload

ANGLES = st.lists(st.floats(-np.pi, np.pi), min_size=6, max_size=6).map(np.array)


@pytest.mark.parametrize("model", list(ArmModel))
@given(q=ANGLES)
def test_gravitys_torques_are_the_controllers(model: ArmModel, q: np.ndarray) -> None:
    robot = RobotModel.load(model)
    closed, rest = robot.description.hand_closed, np.zeros((1, 6))
    hand = robot.description.hand_payload(closed)
    carried = Payload(hand.mass + 1.0, hand.center_of_mass + np.array([0.1, -0.05, 0.05]))
    ours = ArmDynamics.with_payload(robot, closed, carried).torques(q[None], rest, rest)[0]
    controller = ControllerDynamics(MODELS[model.value])
    theirs = controller.step(MODELS[model.value], q, carried.mass, carried.center_of_mass, UPRIGHT, 0.002).torques
    np.testing.assert_allclose(ours, theirs, atol=0.5)  # of 150 Nm; 9.81 and 9.82 m/s^2 make 0.2


@pytest.mark.parametrize("model", list(ArmModel))
def test_each_link_has_its_published_mass_and_a_moment_about_its_centre(model: ArmModel) -> None:
    links = arm_tree(model).links[1:-1]
    assert [link.inertial.mass for link in links if link.inertial] == list(ARM_DATA[model].link_mass)
    for link in links:
        assert link.inertial is not None
        a, b, c = sorted(link.inertial.moments)
        assert 0 < a <= b <= c <= a + b
