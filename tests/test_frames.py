"""The SE(3) functions are what they say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.strategies import rotations, transforms
from toolee_robot.frames import (
    Array,
    angle_between,
    frame_from_axes,
    inverse,
    is_rigid,
    rotation_angle,
    transform,
    transform_points,
)


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
    ],
)
def test_an_array_that_is_no_rigid_transform_is_recognised(X: Array) -> None:
    assert not is_rigid(X)


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
