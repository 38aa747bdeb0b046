"""Fingers that nobody moves are rigid, and nothing else tells of it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from toolee_robot.robots import load_robot
from toolee_robot.sim_backend.physics.bodies import MARGIN, fixed_box, pb, shrink_convex
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


def distance_to_probe(parts: list[trimesh.Trimesh], height: float) -> float:
    """Distance [m] from a ball of 5 mm, `height` over the origin, to a body of these convex parts, by pybullet."""
    client = pb.connect(pb.DIRECT)
    with tempfile.TemporaryDirectory() as folder:
        collisions = ""
        for i, part in enumerate(parts):
            part.export(Path(folder) / f"{i}.obj")
            collisions += f'<collision><geometry><mesh filename="{folder}/{i}.obj"/></geometry></collision>'
        inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
        urdf = Path(folder) / "body.urdf"
        urdf.write_text(f'<robot name="b"><link name="b">{inertial}{collisions}</link></robot>')
        body = pb.loadURDF(str(urdf), physicsClientId=client)
    shape = pb.createCollisionShape(pb.GEOM_SPHERE, radius=0.005, physicsClientId=client)
    ball = pb.createMultiBody(1.0, shape, -1, [0, 0, height], physicsClientId=client)
    points = pb.getClosestPoints(ball, body, 1.0, physicsClientId=client)
    pb.disconnect(client)
    return float(min(p[8] for p in points))


def test_a_compound_body_meets_others_where_its_faces_are() -> None:
    face = trimesh.creation.cylinder(radius=0.014, height=0.06)
    other = trimesh.creation.box((0.02, 0.02, 0.02))
    other.apply_translation([0.1, 0.0, 0.0])
    height = 0.030 + 0.005 + 0.010
    assert distance_to_probe([face, other], height) == pytest.approx(0.010 - MARGIN, abs=1e-4)
    assert distance_to_probe([shrink_convex(face), shrink_convex(other)], height) == pytest.approx(0.010, abs=1e-4)


def test_shrunk_faces_lie_a_margin_deeper() -> None:
    box = trimesh.creation.box((0.02, 0.03, 0.04))
    box.apply_translation([0.5, 0.1, -0.2])
    np.testing.assert_allclose(shrink_convex(box).extents, box.extents - 2 * MARGIN, atol=1e-9)
    np.testing.assert_allclose(shrink_convex(box).centroid, box.centroid, atol=1e-9)


def test_a_part_thinner_than_the_margin_keeps_a_core() -> None:
    sheet = trimesh.creation.box((0.02, 0.03, 0.001))
    core = shrink_convex(sheet)
    assert core.is_watertight
    assert core.extents[2] == pytest.approx(0.0002, rel=0.01)
    assert np.all(core.extents[:2] < sheet.extents[:2])
