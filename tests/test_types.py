"""The records refuse what they cannot mean, and a trajectory is the motion its samples describe."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.errors import raises
from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.types import CameraIntrinsics, InHandEstimate, RgbdFrame, Trajectory

_K = CameraIntrinsics(300.0, 300.0, 4.0, 3.0, 8, 6)


def _cubic(coefficients: np.ndarray, times: np.ndarray) -> Trajectory:
    """A trajectory sampled from cubics, coefficients (4, n), constant first."""
    powers = np.stack([times**k for k in range(4)])
    d1 = np.stack([0 * times, 0 * times + 1, 2 * times, 3 * times**2])
    d2 = np.stack([0 * times, 0 * times, 0 * times + 2, 6 * times])
    return Trajectory(times, powers.T @ coefficients, d1.T @ coefficients, d2.T @ coefficients)


@given(st.lists(st.floats(-2, 2), min_size=8, max_size=8), st.floats(0, 1))
def test_sampling_is_exact_for_cubics_between_uneven_samples(values: list[float], t: float) -> None:
    c = np.array(values).reshape(4, 2)
    trajectory = _cubic(c, np.array([0.0, 0.13, 0.2, 0.71, 1.0]))
    q, qd = trajectory.sample(t)
    np.testing.assert_allclose(q, np.array([1, t, t**2, t**3]) @ c, atol=1e-9)
    np.testing.assert_allclose(qd, np.array([0, 1, 2 * t, 3 * t**2]) @ c, atol=1e-8)


def test_a_trajectory_holds_its_ends_and_knows_its_duration() -> None:
    trajectory = _cubic(np.array([[0.5], [1.0], [0.0], [-0.2]]), np.linspace(0.0, 0.4, 5))
    assert trajectory.duration == pytest.approx(0.4)
    np.testing.assert_allclose(trajectory.sample(-1.0)[0], trajectory.q[0])
    np.testing.assert_allclose(trajectory.sample(9.0)[0], trajectory.q[-1])


@pytest.mark.parametrize("times", [[0.1, 0.2], [0.0, 0.0], [0.0, -1.0], [0.0, float("nan")], [0.0]])
def test_times_that_do_not_run_forward_from_zero_are_refused(times: list[float]) -> None:
    n = len(times)
    with pytest.raises(ValueError, match="traject"):
        Trajectory(np.array(times), np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 6)))


def test_joint_arrays_of_different_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="inconsistent"):
        Trajectory(np.array([0.0, 1.0]), np.zeros((2, 6)), np.zeros((2, 5)), np.zeros((2, 6)))


@pytest.mark.parametrize(
    ("rgb", "depth", "cause"),
    [
        (np.zeros((6, 8), np.uint8), np.zeros((6, 8), np.float32), "rgb_format"),
        (np.zeros((6, 8, 3), np.float32), np.zeros((6, 8), np.float32), "rgb_format"),
        (np.zeros((6, 8, 3), np.uint8), np.zeros((3, 4), np.float32), "depth_size"),
        (np.zeros((6, 8, 3), np.uint8), np.zeros((6, 8), np.uint16), "depth_format"),
        (np.zeros((5, 8, 3), np.uint8), np.zeros((5, 8), np.float32), "image_size"),
    ],
)
def test_a_frame_that_does_not_fit_together_is_refused(rgb: np.ndarray, depth: np.ndarray, cause: str) -> None:
    with raises(UserError, code=f"user.{cause}"):
        RgbdFrame(rgb, depth, _K)


def test_the_sigma_of_a_position_is_that_of_its_worst_direction() -> None:
    covariance = np.diag([1e-6, 4e-6, 1e-6, 0.02**2, 0.03**2, 0.01**2])
    estimate = InHandEstimate(Category.HAMMER_HEAD, np.eye(4), covariance, 0.9, 5, 5, True, "ok")
    assert estimate.sigma_position == pytest.approx(0.002)


@pytest.mark.parametrize("shape", [(), (5,), (3, 4)])
def test_rays_are_the_other_way_round_than_projections(shape: tuple[int, ...]) -> None:
    pixels = np.random.default_rng(0).integers(0, 8, (*shape, 2))
    rays = _K.rays(pixels)
    assert rays.shape == (*shape, 3)
    np.testing.assert_array_equal(rays[..., 2], 1.0)
    np.testing.assert_allclose(_K.project(0.7 * rays), pixels, atol=1e-12)
