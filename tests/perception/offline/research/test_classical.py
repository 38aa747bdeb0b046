"""Classical poses of a tool whose surface is seen exactly, in part."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, angle_between, inverse, transform, transform_points
from toolee_robot.perception.cloud import EeCloud
from toolee_robot.perception.offline.research.classical import centroid_pose, registration
from toolee_robot.tools import NAIL_DRIVERS, Tool, make_tool

X_TRUE = transform(Rotation.from_rotvec([2.3, 0.4, 0.3]), [0.02, -0.03, 0.5])
"""The face in the camera, turned towards it."""


def seen(tool: Tool, X_camera_ee: Array) -> tuple[Array, Array]:
    """Points of the tool's surface that face the camera: of the striking end, and of the rest, camera frame."""
    points, faces = tool.mesh.sample(6000, return_index=True, seed=1)
    X = X_camera_ee @ inverse(tool.ee(Category.HAMMER_HEAD).X_tool_ee)
    at, normals = transform_points(X, points), tool.mesh.face_normals[faces] @ X[:3, :3].T
    visible = at[np.einsum("ij,ij->i", at, normals) < 0.0]
    head = np.linalg.norm(visible - X_camera_ee[:3, 3], axis=1) < 0.03
    return visible[head], visible[~head]


def surface(tool: Tool) -> Array:
    X_ee_tool = inverse(tool.ee(Category.HAMMER_HEAD).X_tool_ee)
    return transform_points(X_ee_tool, tool.mesh.sample(20_000, seed=2))


@pytest.mark.parametrize("seed", range(3))
def test_a_registered_shape_is_where_the_points_are(seed: int) -> None:
    tool = make_tool(NAIL_DRIVERS[seed % len(NAIL_DRIVERS)], 900 + seed)
    head, rest = seen(tool, X_TRUE)
    off = transform(Rotation.from_rotvec([0.1, -0.1, 0.2]), [0.01, 0.02, 0.0])
    X = registration(surface(tool))(EeCloud(head, rest, head[:0]), X_TRUE @ off)
    assert np.linalg.norm(X[:3, 3] - X_TRUE[:3, 3]) < 0.004
    assert angle_between(X[:3, 2], X_TRUE[:3, 2]) < np.deg2rad(4.0)


def test_outliers_do_not_move_a_registered_shape_far() -> None:
    tool = make_tool(NAIL_DRIVERS[0], 900)
    head, rest = seen(tool, X_TRUE)
    wrong = X_TRUE[:3, 3] + np.random.default_rng(0).normal(size=(len(rest) // 10, 3)) * [0.05, 0.05, 0.02]
    X = registration(surface(tool))(EeCloud(head, np.concatenate([rest, wrong]), head[:0]), X_TRUE)
    assert np.linalg.norm(X[:3, 3] - X_TRUE[:3, 3]) < 0.006


def test_a_centroid_keeps_the_nominal_direction_and_finds_the_face_in_front() -> None:
    rng = np.random.default_rng(0)
    disk = rng.uniform(-0.012, 0.012, (500, 3)) * [1, 1, 0]
    body = rng.uniform([-0.012, -0.012, -0.02], [0.012, 0.012, 0.0], (200, 3))
    points = transform_points(X_TRUE, np.concatenate([disk, body]))
    nominal = X_TRUE @ transform(p=[0.02, 0.01, 0.03])
    X = centroid_pose(EeCloud(points, points[:0], points[:0]), nominal)
    np.testing.assert_array_equal(X[:3, :3], nominal[:3, :3])
    np.testing.assert_allclose((inverse(X_TRUE) @ X)[:3, 3], 0.0, atol=0.002)
