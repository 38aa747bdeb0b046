"""Poses compose only where their frames meet, and the SE(3) functions are what they say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.strategies import rotations, transforms
from toolee_robot.errors import FrameMismatchError, TooleeError
from toolee_robot.frames import (
    Array,
    Frame,
    Pose,
    angle_between,
    frame_from_axes,
    inverse,
    is_rigid,
    rotation_angle,
    transform,
    transform_points,
)


@given(transforms(), transforms())
def test_inner_frames_cancel(X_base_camera: Array, X_camera_ee: Array) -> None:
    pose = Pose(Frame.BASE, Frame.CAMERA, X_base_camera) @ Pose(Frame.CAMERA, Frame.EE, X_camera_ee)
    assert (pose.parent, pose.child) == (Frame.BASE, Frame.EE)
    np.testing.assert_allclose(pose.matrix, X_base_camera @ X_camera_ee, atol=1e-12)


def test_composing_frames_that_do_not_meet_raises_and_says_which() -> None:
    a, b = Pose(Frame.BASE, Frame.CAMERA, np.eye(4)), Pose(Frame.HAND, Frame.EE, np.eye(4))
    with pytest.raises(FrameMismatchError, match="X_base_camera @ X_hand_ee") as caught:
        a @ b
    assert isinstance(caught.value, TooleeError)


@given(transforms())
def test_inverse_swaps_the_frames_and_undoes_the_pose(X: Array) -> None:
    pose = Pose(Frame.BASE, Frame.HAND, X)
    assert (pose.inv().parent, pose.inv().child) == (Frame.HAND, Frame.BASE)
    np.testing.assert_allclose((pose @ pose.inv()).matrix, np.eye(4), atol=1e-9)


def test_inverse_takes_batches() -> None:
    rng = np.random.default_rng(0)
    Xs = np.stack([frame_from_axes(z=rng.normal(size=3), x=rng.normal(size=3), p=rng.normal(size=3)) for _ in range(6)])
    Xs = Xs.reshape(2, 3, 4, 4)
    np.testing.assert_allclose(Xs @ inverse(Xs), np.broadcast_to(np.eye(4), Xs.shape), atol=1e-12)


@pytest.mark.parametrize(
    "X",
    [
        np.diag([1.0, 1.0, -1.0, 1.0]),  # a reflection
        2.0 * np.eye(4),
        np.full((4, 4), np.nan),
        np.eye(3),
    ],
)
def test_what_is_not_rigid_is_no_pose(X: Array) -> None:
    with pytest.raises(ValueError, match="not a rigid"):
        Pose(Frame.BASE, Frame.HAND, X)


def test_a_pose_cannot_be_changed_behind_its_back() -> None:
    X = np.eye(4)
    pose = Pose(Frame.BASE, Frame.HAND, X)
    X[0, 3] = 1.0
    assert pose.matrix[0, 3] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        pose.matrix[0, 3] = 1.0


@given(transforms(), st.integers(1, 5))
def test_points_and_their_way_back(X_AB: Array, n: int) -> None:
    p_B = np.random.default_rng(n).normal(size=(n, 3))
    p_A = transform_points(X_AB, p_B)
    np.testing.assert_allclose(p_A[0], (X_AB @ [*p_B[0], 1.0])[:3], atol=1e-12)
    np.testing.assert_allclose(transform_points(inverse(X_AB), p_A), p_B, atol=1e-9)


@given(rotations())
def test_rotation_angle_is_the_norm_of_the_logarithm_and_symmetric(R: Array) -> None:
    angle = rotation_angle(R)
    assert 0.0 <= angle <= np.pi + 1e-9
    assert angle == pytest.approx(rotation_angle(R.T), abs=1e-6)
    assert np.trace(R) == pytest.approx(1 + 2 * np.cos(angle), abs=1e-6)


def test_angles_near_zero_and_pi_are_not_lost() -> None:
    e_x, tiny = np.array([1.0, 0.0, 0.0]), 1e-9
    assert angle_between(e_x, np.array([1.0, tiny, 0.0])) == pytest.approx(tiny, rel=1e-6)
    assert angle_between(e_x, np.array([-1.0, tiny, 0.0])) == pytest.approx(np.pi - tiny)


def test_a_frame_from_axes_keeps_z_and_turns_x_as_little_as_it_must() -> None:
    X = frame_from_axes(z=np.array([0.0, 0.0, 3.0]), x=np.array([2.0, 0.0, 5.0]), p=[1.0, 2.0, 3.0])
    assert is_rigid(X)
    np.testing.assert_allclose(X, transform(np.eye(3), [1.0, 2.0, 3.0]), atol=1e-12)
    with pytest.raises(ValueError, match="parallel"):
        frame_from_axes(z=np.array([0.0, 0.0, 1.0]), x=np.array([0.0, 0.0, -2.0]))
