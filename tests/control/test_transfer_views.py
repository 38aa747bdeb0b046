"""Transfers go around what stands in the way; handover and views are where they must be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.errors import raises
from toolee_robot.control import CollisionWorld, RobotModel, ViewPlan, plan_handover, plan_transfer, plan_views
from toolee_robot.control.collision_shapes import box_body
from toolee_robot.control.planning.transfer import NEED
from toolee_robot.control.planning.views import DISTANCE
from toolee_robot.errors import CollisionError, UnreachableError, UserError
from toolee_robot.frames import Array, angle_between, inverse, transform, transform_points
from toolee_robot.robots import SHADOW_HAND
from toolee_robot.station import StationConfig


def test_straight_transfer_when_nothing_is_in_the_way(
    robot: RobotModel, config: StationConfig, world: CollisionWorld, home: Array
) -> None:
    goal = home + np.array([-0.5, 0.1, -0.1, 0, 0, 0])
    move = plan_transfer(robot, config, world, home, goal)
    assert np.allclose(move.q[0], home)
    assert np.allclose(move.q[-1], goal)
    share = (move.q - home) @ (goal - home) / np.sum((goal - home) ** 2)
    assert np.allclose(move.q, home + share[:, None] * (goal - home), atol=1e-9)
    assert np.max(np.abs(move.qd)) <= config.arm.transfer_velocity_scale * max(config.arm.velocity) + 1e-9


def test_transfer_goes_around_a_pillar(
    robot: RobotModel, config: StationConfig, q_hand: Array, X_hand_ee: Array, home: Array
) -> None:
    start, goal = home + np.array([-0.8, 0, 0, 0, 0, 0]), home + np.array([0.8, 0, 0, 0, 0, 0])
    pillar = box_body("pillar", (0.62, 0.17, 0.25), (0.06, 0.06, 0.5))
    clear = replace(config, work=replace(config.work, nail_xy=(0.0, 0.9)))
    world = CollisionWorld(robot, clear, q_hand, X_hand_ee, extra=(pillar,))
    line = start + np.linspace(0, 1, 50)[:, None] * (goal - start)
    assert world.closest(line).distance < 0, "the straight way must be blocked for this test"
    move = plan_transfer(robot, clear, world, start, goal)
    assert world.closest(move.q, 0.05).distance > 0.5 * NEED
    assert np.allclose(move.q[-1], goal)
    again = plan_transfer(robot, clear, world, start, goal)
    assert np.array_equal(again.q, move.q), "a plan is deterministic"


def test_a_goal_inside_the_table_is_refused(
    robot: RobotModel, config: StationConfig, world: CollisionWorld, home: Array
) -> None:
    with pytest.raises(CollisionError, match="table"):
        plan_transfer(robot, config, world, home, home + np.array([0, 0.6, 0, 0, 0, 0]))
    with raises(UserError, code="user.joint_positions"):
        plan_transfer(robot, config, world, home, home * np.nan)


def test_handover_shows_the_palm_to_the_person(robot: RobotModel, config: StationConfig, home: Array) -> None:
    q_open = robot.description.hand_open
    world = CollisionWorld(robot, config, q_open)
    move = plan_handover(robot, config, world, home, q_open)
    X_base_hand = robot.fk(move.q[-1], q_open)[1]
    assert np.allclose(X_base_hand[:3, 3], config.scene.handover_position, atol=1e-6)
    assert angle_between(-X_base_hand[:3, 1], np.array(config.scene.handover_facing)) < 1e-6
    to_person = np.subtract(config.scene.person_center, config.scene.handover_position)
    assert angle_between(-X_base_hand[:3, 1], to_person * [1, 1, 0]) < np.deg2rad(30)
    unreachable = replace(config, scene=replace(config.scene, handover_position=(0.4, -3.0, 0.6)))
    with raises(UnreachableError, code="unreachable.handover"):
        plan_handover(robot, unreachable, world, home, q_open)


@pytest.fixture(scope="module")
def views(robot: RobotModel, config: StationConfig, q_hand: Array, X_hand_ee: Array, home: Array) -> ViewPlan:
    q_open = robot.description.hand_open
    handover = plan_handover(robot, config, CollisionWorld(robot, config, q_open), home, q_open)
    world = CollisionWorld(robot, config, q_hand, X_hand_ee)
    return plan_views(robot, config, world, handover.q[-1], q_hand, X_hand_ee, count=5)


def test_views_show_face_and_handle(
    robot: RobotModel, config: StationConfig, q_hand: Array, X_hand_ee: Array, views: ViewPlan
) -> None:
    camera = config.camera
    assert len(views.views) == 5
    for view in views.views:
        X_camera_ee = inverse(camera.X_base_camera) @ robot.X_base_ee(view.q, q_hand, X_hand_ee)
        distance = np.linalg.norm(X_camera_ee[:3, 3])
        angle = angle_between(X_camera_ee[:3, 2], -X_camera_ee[:3, 3])
        assert DISTANCE[0] - 1e-9 <= distance <= DISTANCE[1] + 1e-9, "which others are told"
        assert distance == pytest.approx(view.distance)
        assert np.deg2rad(29) <= angle <= np.deg2rad(51)
        assert angle == pytest.approx(view.normal_angle)
        # Face and handle, up to the hand, lie in the image.
        points = transform_points(X_camera_ee, np.array([[0, 0, 0], [0.18, 0, -0.05]]))
        pixels = points @ camera.intrinsics.matrix.T
        pixels = pixels[:, :2] / pixels[:, 2:]
        assert np.all((pixels > 10) & (pixels < [camera.width - 10, camera.height - 10]))
    assert np.allclose(views.views[0].transfer.q[-1], views.views[0].q)
    for before, after in zip(views.views, views.views[1:], strict=False):
        assert np.allclose(after.transfer.q[0], before.q)


def test_views_differ_and_are_free(
    robot: RobotModel, q_hand: Array, X_hand_ee: Array, world: CollisionWorld, views: ViewPlan
) -> None:
    R = [Rotation.from_matrix(robot.X_base_ee(v.q, q_hand, X_hand_ee)[:3, :3]) for v in views.views]
    apart = [(R[i].inv() * R[j]).magnitude() for i in range(5) for j in range(i)]
    assert np.rad2deg(min(apart)) > 12
    for view in views.views:
        assert world.closest(view.q).distance >= NEED
        assert world.closest(view.transfer.q[::5], 0.05).distance > 0.5 * NEED


def test_views_still_show_the_face_when_the_tool_sits_otherwise(
    robot: RobotModel, config: StationConfig, q_hand: Array, X_tool_ee: Array, views: ViewPlan
) -> None:
    """Planned with the nominal grasp; the person hands over with offsets of up to 30 mm, 25 deg and 12 deg."""
    rng = np.random.default_rng(3)
    X_camera_base = inverse(config.camera.X_base_camera)
    shown = []
    for _ in range(60):
        slip = Rotation.from_euler("ZY", [rng.uniform(-25, 25), rng.uniform(-12, 12)], degrees=True)
        X_hand_ee = SHADOW_HAND.grasp.X_hand_tool(0.016) @ transform(slip, [0, 0, rng.uniform(-0.03, 0.03)]) @ X_tool_ee
        good = 0
        for view in views.views:
            X = X_camera_base @ robot.X_base_ee(view.q, q_hand, X_hand_ee)
            angle = np.rad2deg(angle_between(X[:3, 2], -X[:3, 3]))
            good += bool(angle < 65 and 0.33 < np.linalg.norm(X[:3, 3]) < 0.65)
        shown.append(good)
    assert min(shown) >= 4
    assert np.mean(shown) > 4.7


def test_a_camera_out_of_reach_is_named(
    robot: RobotModel, config: StationConfig, world: CollisionWorld, home: Array, q_hand: Array, X_hand_ee: Array
) -> None:
    away = replace(config, camera=replace(config.camera, position=(4.0, -4.0, 1.0), target=(3.0, -3.0, 1.0)))
    with raises(UnreachableError, code="unreachable.views"):
        plan_views(robot, away, world, home, q_hand, X_hand_ee)
