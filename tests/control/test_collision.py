"""Clearance: bounds agree with exact distances, the closest pair is named, what may touch may touch."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin
import pytest

from toolee_robot.control import CollisionWorld, RobotModel
from toolee_robot.control.collision import FAR
from toolee_robot.control.collision_shapes import TOOL_JOINT, Body, arm_bodies, box_body, tool_bodies
from toolee_robot.end_effectors import Category
from toolee_robot.errors import CollisionError
from toolee_robot.frames import Array, inverse, transform, transform_points
from toolee_robot.station import Obstacle, StationConfig, sim_station
from toolee_robot.tools import Family, ToolKind, kinds_of, make_tool
from toolee_robot.tools import test_seeds as seeds_of_test_tools
from toolee_robot.types import ArmModel


def exact(world: CollisionWorld, q: Array) -> dict[tuple[str, str], float]:
    """Every pair's distance straight from coal."""
    R, p = world.robot.arm.joints(q)

    def placed(body: Body) -> coal.Transform3s:
        X = transform() if body.joint == 0 else transform(R[body.joint - 1], p[body.joint - 1])
        X = X @ body.X_joint_shape
        return coal.Transform3s(X[:3, :3], X[:3, 3])

    found = {}
    for i, j in world.pairs:
        a, b = world.bodies[i], world.bodies[j]
        result = coal.DistanceResult()
        found[a.name, b.name] = coal.distance(
            a.geometry, placed(a), b.geometry, placed(b), coal.DistanceRequest(), result
        )
    return found


def test_an_obstacle_of_the_station_file_is_avoided_as_it_is_turned(
    robot: RobotModel, config: StationConfig, q_hand: Array, X_hand_ee: Array, home: Array
) -> None:
    """A slanting panel beside the tool; along the axes of `base` it would be where the tool is."""
    p = robot.X_base_ee(home, q_hand, X_hand_ee)[:3, 3]
    rng = np.random.default_rng(4)
    seen: set[str] = set()
    for turn in (0.0, 0.6, 1.2):
        panel = Obstacle("panel", (p[0] + 0.35, p[1] + 0.1, p[2]), (0.9, 0.02, 0.8), (0.0, 0.3 * turn, turn))
        world = CollisionWorld(
            robot, replace(config, scene=replace(config.scene, obstacles=(panel,))), q_hand, X_hand_ee
        )
        for _ in range(12):
            q = home + rng.normal(0, 0.15, 6)
            pair, distance = min(exact(world, q).items(), key=lambda item: item[1])
            closest = world.closest(q)
            assert (closest.distance <= 0) == (distance <= 0)
            if 0 < distance < FAR:
                assert closest.distance == pytest.approx(distance, abs=1e-6)
                assert closest.pair == pair
            seen |= {"panel"} & set(closest.pair)
    assert seen, "the panel was never near: the test shows nothing"


def test_closest_pair_is_the_exact_one(world: CollisionWorld, home: Array) -> None:
    rng = np.random.default_rng(2)
    near = 0
    for _ in range(25):
        q = home + rng.normal(0, 0.25, 6)
        pair, distance = min(exact(world, q).items(), key=lambda item: item[1])
        closest = world.closest(q)
        if distance >= FAR:
            assert closest.distance == FAR
        elif distance > 0:
            near += 1
            assert closest.distance == pytest.approx(distance, abs=1e-6)
            assert closest.pair == pair
        else:
            assert closest.distance <= 0
    assert near >= 3


def test_a_block_in_the_way_is_named(
    robot: RobotModel, config: StationConfig, q_hand: Array, X_hand_ee: Array, home: Array
) -> None:
    p = robot.X_base_ee(home, q_hand, X_hand_ee)[:3, 3]
    crate = box_body("crate", tuple(p), (0.1, 0.1, 0.1))
    world = CollisionWorld(robot, config, q_hand, X_hand_ee, extra=(crate,))
    with pytest.raises(CollisionError, match="crate"):
        world.check(home, 0.01, "standing here")
    assert world.free(home, 0.01, frozenset((part, "crate") for part in ("tool head", "tool claw", "tool handle")))


@pytest.mark.parametrize("model", list(ArmModel))
def test_covering_spheres_cover(model: ArmModel, config: StationConfig, q_hand: Array, X_hand_ee: Array) -> None:
    for body in CollisionWorld(RobotModel.load(model), config, q_hand, X_hand_ee).bodies:
        if isinstance(body.geometry, coal.Convex):
            vertices = transform_points(body.X_joint_shape, np.asarray(body.geometry.points()))
            gap = np.linalg.norm(vertices[:, None] - body.spheres[:, :3], axis=-1) - body.spheres[:, 3]
            assert np.max(np.min(gap, axis=1)) < 1e-9 - body.geometry.getSweptSphereRadius(), body.name


def test_a_ur10e_reaches_from_joint_to_joint(home: Array) -> None:
    """No gap in the arm's model: every link comes up to the next one's, and the last up to the flange."""
    robot = RobotModel.load(ArmModel.UR10E)
    bodies = {body.name: body for body in arm_bodies(robot)}
    R, p = robot.arm.joints(home)
    names = ("base", "shoulder", "upper arm", "forearm", "wrist 1", "wrist 2", "wrist 3")
    X = [transform(), *(transform(R[i], p[i]) for i in range(6))]
    placed = [coal.Transform3s(x[:3, :3], x[:3, 3]) for x in X]
    for i, (a, b) in enumerate(pairwise(names)):
        result = coal.DistanceResult()
        request = coal.DistanceRequest()
        gap = coal.distance(bodies[a].geometry, placed[i], bodies[b].geometry, placed[i + 1], request, result)
        assert gap < 0.0, (a, b)
    at = coal.Transform3s(np.eye(3), robot.arm.X_joint6_flange[:3, 3])
    result, request = coal.DistanceResult(), coal.DistanceRequest()
    wrist = bodies["wrist 3"].geometry
    assert coal.distance(wrist, coal.Transform3s(), coal.Sphere(0.001), at, request, result) < 0.0


# Lower and upper corners of the real UR10e's links in the link frames [m], read off the maker's collision meshes.
UR10E_LINKS = {
    "base": ((-0.095, -0.095, 0.0), (0.095, 0.095, 0.099)),
    "shoulder": ((-0.076, -0.076, -0.082), (0.076, 0.095, 0.094)),
    "upper arm": ((-0.076, -0.126, -0.077), (0.076, 0.048, 0.672)),
    "forearm": ((-0.058, -0.068, -0.059), (0.058, 0.057, 0.618)),
    "wrist 1": ((-0.047, 0.057, -0.058), (0.047, 0.172, 0.067)),
    "wrist 2": ((-0.047, -0.057, 0.066), (0.047, 0.068, 0.166)),
    "wrist 3": ((-0.044, 0.068, -0.046), (0.044, 0.116, 0.052)),
}


def test_a_ur10e_s_bodies_enclose_its_links() -> None:
    robot = RobotModel.load(ArmModel.UR10E)
    for body in arm_bodies(robot):
        X_joint_link = next(
            frame.placement.homogeneous
            for frame in robot.model.frames
            if frame.name == f"{body.name.replace(' ', '_')}_link" and frame.type == pin.FrameType.BODY
        )
        margin = body.geometry.getSweptSphereRadius()
        points = transform_points(inverse(X_joint_link), body.points)
        lower, upper = UR10E_LINKS[body.name]
        assert np.all(points.min(axis=0) - margin <= lower), body.name
        assert np.all(points.max(axis=0) + margin >= upper), body.name


def test_the_station_file_sets_the_tool_s_envelope(robot: RobotModel, q_hand: Array, X_hand_ee: Array) -> None:
    long = replace(sim_station(), tool_envelope=replace(sim_station().tool_envelope, handle_length=0.6))
    world = CollisionWorld(robot, long, q_hand, X_hand_ee)
    handle = next(body for body in world.bodies if body.name == "tool handle")
    assert 2 * handle.geometry.halfLength == pytest.approx(0.6)


def test_the_envelope_holds_every_kind_of_hammer_for_one_hand() -> None:
    bodies = tool_bodies(sim_station().tool_envelope, np.eye(4), np.eye(4))
    assert all(body.joint == TOOL_JOINT for body in bodies)
    rng = np.random.default_rng(0)
    for kind in kinds_of(Family.HAMMERS):
        if kind is ToolKind.SLEDGE_HAMMER:  # for two hands: no job is asked to swing one
            continue
        for seed in seeds_of_test_tools(60)[::20]:
            tool = make_tool(kind, seed)
            points, _, _ = tool.sample_surface(400, rng)
            points = transform_points(inverse(tool.ee(Category.HAMMER_HEAD).X_tool_ee), points)
            outside = np.full(len(points), np.inf)
            for body in bodies:
                local = transform_points(inverse(body.X_joint_shape), points)
                radial = np.hypot(local[:, 0], local[:, 1]) - body.geometry.radius
                axial = np.abs(local[:, 2]) - body.geometry.halfLength
                outside = np.minimum(outside, np.maximum(radial, axial))
            # Wide mallets and the ends of tilted handles stick out, by no more than the transfers' clearance.
            assert np.max(outside) < 0.012, (kind, seed)
