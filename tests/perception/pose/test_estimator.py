"""The shipped pose estimator on clouds of a known face."""

from __future__ import annotations

import numpy as np
import pytest

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array
from toolee_robot.perception.pose import PoseEstimator, PoseResult
from toolee_robot.perception.pose.estimator import NEAREST


def face_and_handle(distance: float) -> tuple[Array, Array]:
    """A hammer's face of 13 mm radius with 10 mm of its side, and its handle: points (N, 3), (M, 3) [m] in front of the
    camera, the face turned away from the optical axis by 30 degrees.
    """
    rng = np.random.default_rng(0)
    radius, angle = 0.013 * np.sqrt(rng.uniform(size=400)), rng.uniform(0, 2 * np.pi, 400)
    face = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(400)])
    side = rng.uniform(-0.5 * np.pi, 0.5 * np.pi, 200)
    side = np.column_stack([0.013 * np.sin(side), -0.013 * np.cos(side), rng.uniform(0, 0.01, 200)])
    handle = np.column_stack([rng.uniform(-0.012, 0.012, 600), rng.uniform(0.02, 0.25, 600), np.full(600, 0.04)])
    c, s = np.cos(np.deg2rad(30)), np.sin(np.deg2rad(30))
    R = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
    place = [0.02, 0.01, distance]
    return np.concatenate([face, side]) @ R.T + place, handle @ R.T + place


def estimate(distance: float) -> PoseResult:
    points, rest = face_and_handle(distance)
    return PoseEstimator.load().estimate(points, Category.HAMMER_HEAD, rest)


def test_a_cloud_nearer_than_those_of_the_training_is_trusted_as_one_at_their_edge() -> None:
    near, edge = estimate(0.30), estimate(NEAREST)
    np.testing.assert_allclose(near.X_camera_ee[:3, 3] - [0.02, 0.01, 0.30], [0, 0, 0], atol=0.01)
    assert near.confidence == pytest.approx(edge.confidence, abs=0.05)
    assert near.usable == edge.usable
