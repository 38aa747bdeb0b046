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
from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control import RobotModel
from toolee_robot.control.arm_dynamics import ArmDynamics
from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.robots import (
    SHADOW_HAND,
    RobotDescription,
    arm_meshes,
    load_robot,
    wrap_fingers,
    write_urdf,
)
from toolee_robot.robots.description import arm_tree
from toolee_robot.robots.tree import Tree, fuse_links
from toolee_robot.sim_backend.ur_controller.robot.collision_detection import UPRIGHT
from toolee_robot.sim_backend.ur_controller.robot.collision_detection import ArmDynamics as ControllerDynamics
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.station import load_station, sim_station
from toolee_robot.types import ArmModel, HandWeight, Payload


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


EXAMPLES = Path(__file__).parents[2] / "examples"
HOME = np.array(sim_station().scene.home)


def description(station: str) -> RobotDescription:
    """The robot of an example's station, or of the simulated one."""
    config = load_station(EXAMPLES / f"{station}.yaml") if station else sim_station()
    return load_robot(config.arm.model, config.arm.calibration, config.hand)


@pytest.fixture(scope="module")
def robot() -> RobotDescription:
    return description("")


def shapes(tree: Tree, poses: dict[str, Array], kind: str) -> list[tuple[str, tuple[float, ...]]]:
    """What the shapes of a tree are and where, in an order of their own."""
    return sorted(
        (
            f"{shape.kind} {shape.mesh} {shape.size} {shape.scale}",
            tuple(np.round(poses[link.name] @ shape.X_link_shape, 6)[:3].ravel().tolist()),
        )
        for link in tree.links
        for shape in getattr(link, kind)
    )


@pytest.mark.parametrize("closed", [0.0, 0.3])
@pytest.mark.parametrize("station", ["", "ability", "inspire"])
def test_a_robot_with_fused_fingers_has_the_same_dynamics_and_shapes(station: str, closed: float) -> None:
    robot = description(station)
    wrist = len(robot.hand.wrist)
    q = (1.0 - closed) * robot.hand_open + closed * robot.hand_closed
    fixed = robot.tree.with_fixed(dict(zip(robot.hand_joints[wrist:], q[wrist:].tolist(), strict=True)))
    fused = fuse_links(fixed, robot.finger_links)
    assert len(fused.tree.links) < len(fixed.links) - 5
    root = robot.hand.tree.links[0].name  # whose joint is the force sensor
    assert fused.tree.by_name[root].inertial == fixed.by_name[root].inertial
    moving = np.concatenate([HOME, q[:wrist]])
    poses, expected = fused.tree.link_poses(moving), robot.link_poses(HOME, q)
    for name, (at, X) in fused.places.items():
        np.testing.assert_allclose(poses[at] @ X, expected[name], atol=1e-12)
    models = [pin.buildModelFromXML(write_urdf("robot", tree)) for tree in (fixed, fused.tree)]
    one, other = (pin.crba(model, model.createData(), moving) for model in models)
    np.testing.assert_allclose(one, other, atol=1e-9)
    one, other = (pin.computeGeneralizedGravity(model, model.createData(), moving) for model in models)
    np.testing.assert_allclose(one, other, atol=1e-7)
    for kind in ("visuals", "collisions"):
        for a, b in zip(shapes(fused.tree, poses, kind), shapes(fixed, expected, kind), strict=True):
            assert a[0] == b[0]
            np.testing.assert_allclose(a[1], b[1], atol=2e-6)


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
