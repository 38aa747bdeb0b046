"""Fingers that nobody moves are rigid, and nothing else tells of it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from toolee_robot.robots import load_robot
from toolee_robot.sim_backend.physics.bodies import fixed_box, pb
from toolee_robot.sim_backend.physics.robot_body import RobotBody
from toolee_robot.station import sim_station

DT = 0.001
HOME = np.array(sim_station().scene.home)
FASTER = np.array([0.4, -0.3, 0.5, 0.2, -0.6, 0.7])  # [rad/s]


@pytest.fixture
def body() -> Iterator[RobotBody]:
    client = pb.connect(pb.DIRECT)
    pb.setGravity(0.0, 0.0, -9.81, physicsClientId=client)
    robot = load_robot()
    yield RobotBody(client, robot, HOME, robot.hand_open)
    pb.disconnect(client)


def run(body: RobotBody, steps: int) -> None:
    pb.setPhysicsEngineParameter(fixedTimeStep=DT, numSubSteps=0, physicsClientId=body._client)
    for _ in range(steps):
        body.before_step(DT)
        pb.stepSimulation(physicsClientId=body._client)


@pytest.mark.nightly
@pytest.mark.sim
def test_fingers_move_when_commanded_and_stay_where_they_are_made_rigid(body: RobotBody) -> None:
    wrist = len(body.robot.hand.wrist)
    half = 0.5 * (body.robot.hand_open + body.robot.hand_closed)
    body.command_hand(half)
    run(body, 1000)
    q = body.hand_state()[0]
    assert np.abs(q - half)[wrist:].max() < 0.02
    tip = body.link_poses()["rh_ffdistal"]
    body.stiffen()
    np.testing.assert_allclose(body.hand_state()[0], q, atol=1e-6)
    np.testing.assert_allclose(body.link_poses()["rh_ffdistal"], tip, atol=1e-5)
    run(body, 200)
    np.testing.assert_allclose(body.hand_state()[0][wrist:], q[wrist:], atol=1e-12)
    assert np.all(body.hand_state()[1][wrist:] == 0.0)
    body.command_hand(body.robot.hand_open)
    run(body, 1000)
    assert np.abs(body.hand_state()[0] - body.robot.hand_open)[wrist:].max() < 0.02


@pytest.mark.sim
def test_an_arm_in_motion_goes_on_when_its_fingers_become_rigid_and_move_again(body: RobotBody) -> None:
    body.command_arm(HOME, FASTER)
    run(body, 300)
    for rigid in (False, True):
        q, qd = body.arm_state()
        if rigid:
            body.stiffen()
        else:
            body.command_hand(body.robot.hand_closed)
        for now, before in zip(body.arm_state(), (q, qd), strict=True):
            np.testing.assert_allclose(now, before, atol=1e-9)
        np.testing.assert_allclose(qd, FASTER, atol=0.02)
        run(body, 50)
    np.testing.assert_allclose(body.arm_state()[0], HOME + 0.4 * FASTER, atol=0.002)


@pytest.mark.sim
def test_the_force_sensor_feels_the_same_hand(body: RobotBody) -> None:
    def weight() -> float:
        run(body, 300)
        return float(np.linalg.norm(body.sensor_reaction()[:3]))

    rigid = weight()
    body.command_hand(body.robot.hand_open + 1e-6)
    assert weight() == pytest.approx(rigid, rel=1e-3)
    assert rigid > 30.0


@pytest.mark.sim
def test_what_does_not_collide_with_the_robot_never_does(body: RobotBody) -> None:
    palm = body.link_pose(body.palm)[:3, 3]
    box = fixed_box(body._client, (0.2, 0.2, 0.2), palm, (0.5, 0.5, 0.5))

    def contacts() -> int:
        run(body, 1)
        return len(pb.getContactPoints(bodyA=body.body, bodyB=box, physicsClientId=body._client))

    assert contacts()
    body.ignore_collisions(box)
    assert not contacts()
    body.command_hand(body.robot.hand_closed)
    assert not contacts()
    body.stiffen()
    assert not contacts()
