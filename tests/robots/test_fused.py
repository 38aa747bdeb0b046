"""Links that do not move against each other, as one: the same masses in the same places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from toolee_robot.frames import Array
from toolee_robot.robots import RobotDescription, load_robot, write_urdf
from toolee_robot.robots.tree import Inertial, Tree, combined, fuse_links
from toolee_robot.station import load_station, sim_station

EXAMPLES = Path(__file__).parents[2] / "examples"
HOME = np.array(sim_station().scene.home)


def description(station: str) -> RobotDescription:
    """The robot of an example's station, or of the simulated one."""
    config = load_station(EXAMPLES / f"{station}.yaml") if station else sim_station()
    return load_robot(config.arm.model, config.arm.calibration, config.hand)


@pytest.fixture(scope="module")
def robot() -> RobotDescription:
    return description("")


@st.composite
def bodies(draw: st.DrawFn) -> Inertial:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    X = np.eye(4)
    X[:3, :3] = pin.exp3(rng.normal(size=3))
    X[:3, 3] = rng.normal(size=3)
    a, b, c = rng.uniform(1e-3, 1.0, 3)  # principal moments fulfil the triangle inequality
    return Inertial(float(rng.uniform(0.001, 5.0)), X, (a + b, b + c, c + a))


def spatial(body: Inertial) -> pin.Inertia:
    R = body.X_link_com[:3, :3]
    return pin.Inertia(body.mass, body.X_link_com[:3, 3], R @ np.diag(body.moments) @ R.T)


@given(st.lists(bodies(), min_size=1, max_size=5))
def test_the_inertia_of_several_bodies_is_the_sum_of_theirs(parts: list[Inertial]) -> None:
    whole = combined(parts)
    expected = sum((spatial(part) for part in parts[1:]), spatial(parts[0]))
    np.testing.assert_allclose(spatial(whole).matrix(), expected.matrix(), rtol=1e-9, atol=1e-9)
    assert np.linalg.det(whole.X_link_com[:3, :3]) == pytest.approx(1.0)


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


def test_what_a_fused_link_carries_is_carried_by_its_parent_and_joints_that_move_stay(robot: RobotDescription) -> None:
    fused = fuse_links(robot.tree, robot.finger_links)  # nothing is fixed: nothing to fuse
    assert [link.name for link in fused.tree.links] == [link.name for link in robot.tree.links]
    assert not fused.places
    fused = fuse_links(robot.tree, {"tool0"})
    assert fused.tree.by_name["rh_forearm"].parent == "wrist_3_link"
    q = np.concatenate([HOME, robot.hand_closed])
    np.testing.assert_allclose(
        fused.tree.link_poses(q)["rh_thdistal"], robot.tree.link_poses(q)["rh_thdistal"], atol=1e-12
    )
