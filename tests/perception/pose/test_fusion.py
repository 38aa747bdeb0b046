"""Fusion of several frames in the hand frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.errors import raises
from toolee_robot.end_effectors import Category
from toolee_robot.errors import PerceptionError
from toolee_robot.frames import Array, angle_between, skew, transform
from toolee_robot.perception.pose.fusion import FLOOR_ANGLE, FLOOR_POSITION, UNKNOWN_CAMERA, fuse_in_hand
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


def calibrated(Xs_camera_hand: list[Array], error: Array) -> list[Array]:
    """The same poses by a calibration with an error: translation [m] and rotation vector [rad], camera's axes, (6,)."""
    off = transform(Rotation.from_rotvec(error[3:]), error[:3])
    return [np.linalg.inv(off) @ X for X in Xs_camera_hand]


def turned(rng: np.random.Generator, n: int, spread: float) -> list[Array]:
    """Poses of the hand before the camera whose orientations differ by about `spread` [rad]."""
    middle = Rotation.random(rng=rng)
    turns = [Rotation.from_rotvec(rng.normal(0.0, spread / np.sqrt(3), 3)) for _ in range(n)]
    return [transform(turn * middle, rng.normal([0.0, 0.0, 0.6], 0.05)) for turn in turns]


def seen_by(
    rng: np.random.Generator, hands: list[Array], sigma_p: float = 0.001, sigma_r: float = np.deg2rad(1.0)
) -> list[Frame]:
    """What a network sees of the tool in these poses."""
    frames = []
    for X_camera_hand in hands:
        X = X_camera_hand @ X_TRUE
        X = transform(Rotation.from_rotvec(rng.normal(0, sigma_r, 3)) * Rotation.from_matrix(X[:3, :3]), X[:3, 3])
        X[:3, 3] += rng.normal(0, sigma_p, 3)
        C = np.diag([sigma_p**2] * 3 + [sigma_r**2] * 3)
        frames.append(Frame(Category.HAMMER_HEAD, X, C))
    return frames


def test_views_tell_the_cameras_error_from_the_tools_pose() -> None:
    """Six views that differ by 35 degrees, from a camera that is 12 mm and 1 degree off."""
    rng = np.random.default_rng(6)
    one, six, squared, found = [], [], [], []
    for _ in range(40):
        error = np.concatenate([rng.normal(0, 0.007, 3), rng.normal(0, np.deg2rad(0.6), 3)])
        hands = turned(rng, 6, np.deg2rad(35.0))
        frames = seen_by(rng, hands)
        result = fuse_in_hand(frames, calibrated(hands, error))
        assert result.usable
        assert result.frames_used == 6
        single = fuse_in_hand(frames[:1], calibrated(hands[:1], error))
        one.append(np.linalg.norm(single.X_hand_ee[:3, 3] - X_TRUE[:3, 3]))
        off = result.X_hand_ee[:3, 3] - X_TRUE[:3, 3]
        six.append(np.linalg.norm(off))
        squared.append(off @ np.linalg.solve(result.covariance[:3, :3], off) / 3)
        assert result.camera is not None
        p = (hands[0] @ X_TRUE)[:3, 3]
        J = np.hstack([np.eye(3), -skew(p)])
        found.append(np.linalg.norm(J @ (result.camera.mean - error)))
        assert result.camera.at(p)[0] == pytest.approx(np.linalg.norm(J @ result.camera.mean))
    assert np.median(one) > 0.010
    assert np.median(six) < 0.002
    assert np.median(found) < 0.002
    assert np.mean(squared) < 1.2


def test_views_alike_leave_the_cameras_error_in_the_covariance() -> None:
    """What turns with neither hand nor camera cannot be told apart: the pose is what the camera says, and uncertain."""
    rng = np.random.default_rng(7)
    hands = [turned(rng, 1, 0.0)[0]] * 6
    frames = seen_by(rng, hands)
    result = fuse_in_hand(frames, calibrated(hands, np.array([0.008, 0.0, 0.0, 0.0, 0.0, 0.0])))
    off = result.X_hand_ee[:3, 3] - X_TRUE[:3, 3]
    assert 0.007 < np.linalg.norm(off) < 0.009
    assert result.sigma_position > UNKNOWN_CAMERA.at(frames[0].X_camera_ee[:3, 3])[1] > 0.004


@pytest.mark.nightly
def test_a_later_look_knows_the_camera() -> None:
    """Two views say more once six have told the camera's error."""
    rng = np.random.default_rng(8)
    knowing, anew = [], []
    for _ in range(40):
        error = np.concatenate([rng.normal(0, 0.007, 3), rng.normal(0, np.deg2rad(0.6), 3)])
        hands = turned(rng, 6, np.deg2rad(35.0))
        first = fuse_in_hand(seen_by(rng, hands), calibrated(hands, error))
        hands = turned(rng, 2, np.deg2rad(20.0))
        frames, told = seen_by(rng, hands), calibrated(hands, error)
        assert first.camera is not None
        later = fuse_in_hand(frames, told, camera=first.camera)
        knowing.append(np.linalg.norm(later.X_hand_ee[:3, 3] - X_TRUE[:3, 3]))
        anew.append(np.linalg.norm(fuse_in_hand(frames, told).X_hand_ee[:3, 3] - X_TRUE[:3, 3]))
        assert later.sigma_position < 0.008
    assert np.median(knowing) < 0.003
    assert np.median(knowing) < 0.6 * np.median(anew)
