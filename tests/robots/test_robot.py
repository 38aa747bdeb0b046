"""One robot, three readers: our numpy kinematics, Pinocchio and pybullet agree."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pybullet as p
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from toolee_robot.control import RobotModel
from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.robots import (
    SHADOW_HAND,
    arm_meshes,
    load_robot,
    wrap_fingers,
)
from toolee_robot.station import sim_station
from toolee_robot.types import HandWeight


def _configurations(n: int) -> Array:
    robot = load_robot()
    rng = np.random.default_rng(7)
    return rng.uniform(robot.lower, robot.upper, (n, len(robot.lower)))


@pytest.fixture(scope="module")
def client() -> Iterator[int]:
    client = p.connect(p.DIRECT)
    yield client
    p.disconnect(client)


def test_forward_kinematics_agree_with_pinocchio() -> None:
    robot = load_robot()
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    names = (*robot.arm_joints, *robot.hand_joints)
    index = [model.joints[model.getJointId(name)].idx_q for name in names]
    for q in _configurations(20):
        q_pin = np.zeros(model.nq)
        q_pin[index] = q
        pin.framesForwardKinematics(model, data, q_pin)
        for name, X in robot.link_poses(q[:6], q[6:]).items():
            np.testing.assert_allclose(data.oMf[model.getFrameId(name)].homogeneous, X, atol=1e-9)


def test_forward_kinematics_agree_with_pybullet(client: int, tmp_path: Path) -> None:
    robot = load_robot()
    (tmp_path / "robot.urdf").write_text(robot.urdf)
    file, flags = str(tmp_path / "robot.urdf"), p.URDF_USE_INERTIA_FROM_FILE
    body = p.loadURDF(file, useFixedBase=True, flags=flags, physicsClientId=client)
    infos = [
        p.getJointInfo(body, i, physicsClientId=client) for i in range(p.getNumJoints(body, physicsClientId=client))
    ]
    movable = [i for i, info in enumerate(infos) if info[2] == p.JOINT_REVOLUTE]
    assert [infos[i][1].decode() for i in movable] == [*robot.arm_joints, *robot.hand_joints]
    for q in _configurations(20):
        for i, value in zip(movable, q, strict=True):
            p.resetJointState(body, i, value, physicsClientId=client)
        poses = robot.link_poses(q[:6], q[6:])
        for i, info in enumerate(infos):
            state = p.getLinkState(body, i, computeForwardKinematics=True, physicsClientId=client)
            X = poses[info[12].decode()]
            np.testing.assert_allclose(state[4], X[:3, 3], atol=1e-6)
            R = np.array(p.getMatrixFromQuaternion(state[5])).reshape(3, 3)
            np.testing.assert_allclose(R, X[:3, :3], atol=1e-6)


def test_masses_agree(client: int, tmp_path: Path) -> None:
    robot = load_robot()
    model = pin.buildModelFromXML(robot.urdf)
    (tmp_path / "robot.urdf").write_text(robot.urdf)
    file, flags = str(tmp_path / "robot.urdf"), p.URDF_USE_INERTIA_FROM_FILE
    body = p.loadURDF(file, useFixedBase=True, flags=flags, physicsClientId=client)
    links = range(p.getNumJoints(body, physicsClientId=client))
    inertial = {link.name: link.inertial.mass if link.inertial else 0.0 for link in robot.tree.links}
    for i in links:
        name = p.getJointInfo(body, i, physicsClientId=client)[12].decode()
        assert p.getDynamicsInfo(body, i, physicsClientId=client)[0] == pytest.approx(inertial[name], rel=1e-6)
    assert pin.computeTotalMass(model) == pytest.approx(sum(inertial.values()) - inertial["base_link"], rel=1e-9)


def test_every_collision_shape_reaches_pinocchio() -> None:
    robot = load_robot()
    model = pin.buildModelFromXML(robot.urdf)
    geometry = pin.buildGeomFromUrdfString(model, robot.urdf, pin.GeometryType.COLLISION)
    assert len(geometry.geometryObjects) == sum(len(link.collisions) for link in robot.tree.links)


def test_hand_poses_are_relative_to_the_palm() -> None:
    robot = load_robot()
    q = _configurations(1)[0]
    base = robot.link_poses(q[:6], q[6:])
    hand = SHADOW_HAND.link_poses(q[6:])
    np.testing.assert_allclose(hand[SHADOW_HAND.frame], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(base[SHADOW_HAND.frame] @ hand["rh_thdistal"], base["rh_thdistal"], atol=1e-9)
    X_flange_hand = inverse(base["tool0"]) @ base[SHADOW_HAND.frame]
    np.testing.assert_allclose(robot.X_flange_hand(q[6:]), X_flange_hand, atol=1e-9)


def test_meshes_are_metric_and_light() -> None:
    for meshes, limit in ((SHADOW_HAND.meshes, 8500), (arm_meshes(), 8500)):
        assert sum(len(mesh.faces) for mesh in meshes.values()) < limit
        for mesh in meshes.values():
            assert 0.005 < mesh.extents.max() < 1.0
    poses = SHADOW_HAND.link_poses(load_robot().hand_open)
    tips = max(
        float(transform_points(poses[n], np.asarray(m.vertices))[:, 2].max()) for n, m in SHADOW_HAND.meshes.items()
    )
    assert 0.17 < tips < 0.22  # an adult's hand


@given(radius=st.floats(0.010, 0.018))
@examples(10)
def test_fingers_wrap_without_sinking_into_the_handle(radius: float) -> None:
    X = SHADOW_HAND.grasp.X_hand_tool(radius)
    q = wrap_fingers(SHADOW_HAND, X, radius, press=0.0005)
    robot = load_robot()
    assert np.all(q >= robot.lower[6:] - 1e-9)
    assert np.all(q <= robot.upper[6:] + 1e-9)
    poses = SHADOW_HAND.link_poses(q)
    fingertips = [poses[f"rh_{f}distal"] @ [0.0, 0.0, 0.024, 1.0] for f in ("ff", "mf", "rf", "lf")]
    for tip in fingertips:
        in_tool = inverse(X) @ tip
        assert np.hypot(in_tool[0], in_tool[1]) > radius + 0.006  # the axis of a capsule of 7 mm radius, outside
        assert np.hypot(in_tool[0], in_tool[1]) < radius + 0.035
        assert in_tool[1] > 0  # around the far side: palmar is tool y


def test_a_weighed_hand_is_the_payload_in_every_posture() -> None:
    """What a lab has weighed goes to the controller, not the masses of a model that nobody can edit."""
    weighed = HandWeight(4.2, (0.001, -0.002, 0.12))
    robot = RobotModel.of_station(replace(sim_station(), hand=replace(sim_station().hand, weighed=weighed)))
    for q_hand in (robot.description.hand_open, robot.description.hand_closed):
        payload = robot.description.hand_payload(q_hand)
        assert payload.mass == weighed.mass
        np.testing.assert_array_equal(payload.center_of_mass, weighed.center_of_mass)
    carried = robot.payload(robot.description.hand_closed, np.eye(4), 1.0, np.zeros(3))
    assert carried.mass == pytest.approx(5.2)
