"""Fusion of several frames in the hand frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.errors import raises
from toolee_robot.end_effectors import Category
from toolee_robot.errors import PerceptionError
from toolee_robot.frames import Array, angle_between, transform
from toolee_robot.perception.pose.fusion import FLOOR_ANGLE, FLOOR_POSITION, fuse_in_hand
from toolee_robot.perception.pose.pooling import FREE_SPIN_VARIANCE
from toolee_robot.types import InHandEstimate

SIGMA_P, SIGMA_R = 0.003, np.deg2rad(4.0)


@dataclass(frozen=True)
class Frame:
    category: Category
    X_camera_ee: Array
    covariance: Array
    confidence: float = 0.9
    usable: bool = True


def covariance(R_camera_ee: Array, spin_variance: float) -> Array:
    C = np.diag([SIGMA_P**2] * 3 + [0.0] * 3)
    C[3:, 3:] = R_camera_ee @ np.diag([SIGMA_R**2, SIGMA_R**2, spin_variance]) @ R_camera_ee.T
    return C


def looks(
    rng: np.random.Generator, X_hand_ee: Array, n: int, category: Category = Category.HAMMER_HEAD, free: bool = False
) -> tuple[list[Frame], list[Array]]:
    frames, hands = [], []
    for _ in range(n):
        X_camera_hand = transform(Rotation.random(rng=rng), rng.normal([0.0, 0.0, 0.6], 0.1))
        X = X_camera_hand @ X_hand_ee
        X = transform(
            Rotation.from_rotvec(rng.normal(0, SIGMA_R, 3)).as_matrix() @ X[:3, :3],
            X[:3, 3] + rng.normal(0, SIGMA_P, 3),
        )
        if free:
            X[:3, :3] = X[:3, :3] @ Rotation.from_rotvec([0, 0, rng.uniform(-np.pi, np.pi)]).as_matrix()
        frames.append(Frame(category, X, covariance(X[:3, :3], FREE_SPIN_VARIANCE if free else SIGMA_R**2)))
        hands.append(X_camera_hand)
    return frames, hands


X_TRUE = transform(Rotation.from_euler("xyz", [20, -35, 50], degrees=True), [0.05, -0.03, 0.11])


@pytest.mark.parametrize("free", [False, True])
def test_fusion_beats_single_frames(free: bool) -> None:
    rng = np.random.default_rng(0)
    single_p, single_z, fused_p, fused_z = [], [], [], []
    for _ in range(30):
        frames, hands = looks(rng, X_TRUE, 8, free=free)
        result = fuse_in_hand(frames, hands)
        one = np.linalg.inv(hands[0]) @ frames[0].X_camera_ee
        single_p.append(np.linalg.norm(one[:3, 3] - X_TRUE[:3, 3]))
        single_z.append(angle_between(one[:3, 2], X_TRUE[:3, 2]))
        fused_p.append(np.linalg.norm(result.X_hand_ee[:3, 3] - X_TRUE[:3, 3]))
        fused_z.append(angle_between(result.X_hand_ee[:3, 2], X_TRUE[:3, 2]))
        assert result.usable
    assert np.median(fused_p) < 0.6 * np.median(single_p)
    assert np.median(fused_z) < 0.6 * np.median(single_z)


def test_outlying_frames_are_dropped() -> None:
    rng = np.random.default_rng(1)
    frames, hands = looks(rng, X_TRUE, 6)
    clean = fuse_in_hand(frames, hands)
    for i in (1, 4):
        frames[i] = Frame(
            Category.HAMMER_HEAD,
            frames[i].X_camera_ee @ transform(Rotation.from_euler("x", 160 + i, degrees=True), [0.02, 0.03, 0.0]),
            frames[i].covariance,
        )
    result = fuse_in_hand(frames, hands)
    assert result.frames_used == 4
    assert result.frames_seen == 6
    assert np.linalg.norm(result.X_hand_ee[:3, 3] - clean.X_hand_ee[:3, 3]) < 0.003
    assert angle_between(result.X_hand_ee[:3, 2], X_TRUE[:3, 2]) < np.deg2rad(5)


def sigma_normal(estimate: InHandEstimate) -> float:
    """Standard deviation [rad] of the direction of the EE's z axis, the larger of its two."""
    z = estimate.X_hand_ee[:3, 2]
    P = np.eye(3) - np.outer(z, z)
    return float(np.sqrt(np.linalg.eigvalsh(P @ estimate.covariance[3:, 3:] @ P)[-1]))


def test_covariance_is_honest_and_has_a_floor() -> None:
    rng = np.random.default_rng(2)
    squared = []
    for _ in range(60):
        frames, hands = looks(rng, X_TRUE, 6)
        result = fuse_in_hand(frames, hands)
        dp = result.X_hand_ee[:3, 3] - X_TRUE[:3, 3]
        squared.append(dp @ np.linalg.solve(result.covariance[:3, :3], dp) / 3)
    assert np.mean(squared) < 1.2
    many, hands = looks(rng, X_TRUE, 40)
    result = fuse_in_hand(many, hands)
    assert result.sigma_position > FLOOR_POSITION
    assert sigma_normal(result) > FLOOR_ANGLE


def test_a_free_spin_stays_free() -> None:
    frames, hands = looks(np.random.default_rng(3), X_TRUE, 6, free=True)
    result = fuse_in_hand(frames, hands)
    z = result.X_hand_ee[:3, 2]
    assert z @ result.covariance[3:, 3:] @ z > 0.3 * FREE_SPIN_VARIANCE
    assert sigma_normal(result) < np.deg2rad(5)


def test_flipped_wrench_frames_agree() -> None:
    frames, hands = looks(np.random.default_rng(4), X_TRUE, 6, Category.WRENCH_HEAD)
    flip = transform(Category.WRENCH_HEAD.symmetry.elements()[1])
    frames = [
        Frame(f.category, f.X_camera_ee @ flip if i % 2 else f.X_camera_ee, f.covariance) for i, f in enumerate(frames)
    ]
    result = fuse_in_hand(frames, hands)
    assert result.frames_used == 6
    assert Category.WRENCH_HEAD.symmetry.rotation_error(result.X_hand_ee[:3, :3], X_TRUE[:3, :3]) < np.deg2rad(5)


def test_contradicting_or_unusable_frames_are_refused() -> None:
    rng = np.random.default_rng(5)
    frames, hands = looks(rng, X_TRUE, 4)
    scattered = [
        Frame(f.category, f.X_camera_ee @ transform(Rotation.random(rng=rng), rng.normal(0, 0.1, 3)), f.covariance)
        for f in frames
    ]
    result = fuse_in_hand(scattered, hands)
    assert not result.usable
    assert "disagree" in result.reason
    doubtful = [Frame(f.category, f.X_camera_ee, f.covariance, 0.1, False) for f in frames]
    result = fuse_in_hand(doubtful, hands)
    assert not result.usable
    assert "0 of 4" in result.reason
    with raises(PerceptionError, code="perception.no_frames"):
        fuse_in_hand([], [])
