"""Commands that must never reach an arm: each is a good motion with one thing wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from toolee_robot.control.planning.timing import joint_move
from toolee_robot.faults.rigs.strikes import Swing
from toolee_robot.frames import Array
from toolee_robot.types import Trajectory

STEP = 0.004  # [s] between the samples of a hand-made trajectory
BESIDE = 1e-3  # [rad] from where the arm was last commanded: about a millimetre at the tool


def good(swing: Swing, q: Array, change: Array) -> Trajectory:
    """A slow motion from q (6,) by `change` (6,) [rad], straight in joint space."""
    limits = swing.config.arm
    return joint_move(q, q + change, np.full(6, 0.4), np.full(6, 2.0), np.full(6, limits.jerk))


def not_finite(swing: Swing, q: Array, value: float) -> Trajectory:
    """NaN or infinity in the middle of it."""
    motion = good(swing, q, np.full(6, 0.02))
    broken = motion.q.copy()
    broken[len(broken) // 2, 3] = value
    return replace(motion, q=broken)


def beyond_joint_limit(swing: Swing, q: Array) -> Trajectory:
    """The last joint turns on past two turns."""
    change = np.zeros(6)
    change[5] = 2 * np.pi + 0.2 - q[5]
    return good(swing, q, change)


def _integrated(q: Array, qdd: Array) -> Trajectory:
    """Joint 1 with these accelerations (N,) [rad/s^2], one a step."""
    n = len(qdd)
    speed = np.concatenate([[0.0], np.cumsum(qdd[:-1]) * STEP])
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) * STEP])
    times: Array = np.linspace(0.0, (n - 1) * STEP, n)
    first = np.eye(6)[0]
    return Trajectory(times, q + np.outer(way, first), np.outer(speed, first), np.outer(qdd, first))


def beside_the_arm(swing: Swing, q: Array) -> Trajectory:
    """A good motion, of an arm that stands BESIDE this one."""
    return good(swing, q + BESIDE, np.full(6, 0.02))


def velocity_step(q: Array) -> Trajectory:
    """From rest to 0.5 rad/s between two samples."""
    qdd = np.zeros(60)
    motion = _integrated(q, qdd)
    way, speed = motion.q.copy(), motion.qd.copy()
    speed[10:, 0] = 0.5
    way[10:, 0] += 0.5 * STEP * np.arange(50)
    return replace(motion, q=way, qd=speed)


def acceleration_step(swing: Swing, q: Array) -> Trajectory:
    """Twice the joints' acceleration limit for a moment."""
    most = swing.config.arm.acceleration
    return _integrated(q, np.concatenate([np.zeros(5), np.full(5, 2 * most), np.full(5, -2 * most), np.zeros(5)]))


def jerk_step(swing: Swing, q: Array) -> Trajectory:
    """Back and forth between the acceleration limits, which they never exceed."""
    most = 0.8 * swing.config.arm.acceleration
    return _integrated(q, np.concatenate([np.zeros(4), np.tile([most, most, -most, -most], 6), np.zeros(4)]))


def out_of_workspace(swing: Swing, q: Array) -> Trajectory:
    """Turned around and stretched out, beyond the back of the workspace."""
    target = np.array([np.pi, -0.4, 0.0, q[3], q[4], q[5]])
    return good(swing, q, target - q)


def into_the_table(swing: Swing, q: Array) -> Trajectory:
    """The shoulder goes on down."""
    change = np.zeros(6)
    change[1] = 0.6
    return good(swing, q, change)


def into_itself(swing: Swing, q: Array) -> Trajectory:
    """The elbow folds up."""
    change = np.zeros(6)
    change[2] = 2.95 - q[2]
    return good(swing, q, change)


def too_fast_for_a_handover(swing: Swing) -> Trajectory:
    """The strike itself."""
    return swing.plan.strike
