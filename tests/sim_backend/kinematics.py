"""Inverse kinematics by least squares, and straight trajectories, for tests of the simulation alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from toolee_robot.frames import Array, transform_points
from toolee_robot.robots import load_robot
from toolee_robot.types import Trajectory

HOME = np.array([-0.6, -1.7, 1.6, -1.47, -1.57, 0.0])


def joints_for_hand(X_base_hand: Array, start: Array = HOME) -> Array:
    """Arm joints (6,) that put the palm, with the hand open, at X_base_hand (4x4)."""
    robot = load_robot()
    corners = 0.2 * np.vstack([np.zeros(3), np.eye(3)])

    def error(q: Array) -> Array:
        X = robot.link_poses(q, robot.hand_open)[robot.hand_frame]
        return (transform_points(X, corners) - transform_points(X_base_hand, corners)).ravel()

    rng = np.random.default_rng(0)
    for attempt in range(20):
        guess = start + (0 if attempt == 0 else rng.uniform(-0.8, 0.8, 6))
        result = least_squares(error, guess, xtol=1e-12, ftol=1e-12)
        if np.abs(result.fun).max() < 1e-6:
            return np.asarray(result.x)
    raise AssertionError("no inverse kinematics for this pose")


def line(points: Sequence[Array], duration: float) -> Trajectory:
    """Smooth motion (quintic in time) through the first and last of `points` (6,) in a straight joint line."""
    a, b = np.asarray(points[0]), np.asarray(points[-1])
    times = np.linspace(0.0, duration, max(3, round(duration * 250)))
    s = times / duration
    f = 10 * s**3 - 15 * s**4 + 6 * s**5
    df = (30 * s**2 - 60 * s**3 + 30 * s**4) / duration
    ddf = (60 * s - 180 * s**2 + 120 * s**3) / duration**2
    return Trajectory(times, a + f[:, None] * (b - a), df[:, None] * (b - a), ddf[:, None] * (b - a))
