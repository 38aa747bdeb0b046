"""Faulty commands that must never reach an arm: valid motions with one defect each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.rigs.strikes import Swing
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.frames import Array
from toolee_robot.types import Trajectory

STEP = 0.004  # [s], sample period
BESIDE = 1e-3  # [rad], offset from the commanded position: about a millimetre at the tool


def good(swing: Swing, q: Array, change: Array) -> Trajectory:
    """Make a valid, slow motion, straight in joint space."""
    limits = swing.config.arm
    return joint_move(q, q + change, np.full(6, 0.4), np.full(6, 2.0), np.full(6, limits.jerk))


def not_finite(swing: Swing, q: Array, value: float) -> Trajectory:
    """Make a motion with NaN or infinity in its middle."""
    motion = good(swing, q, np.full(6, 0.02))
    broken = motion.q.copy()
    broken[len(broken) // 2, 3] = value
    return replace(motion, q=broken)


def beyond_joint_limit(swing: Swing, q: Array) -> Trajectory:
    """Make a motion of the last joint beyond its limit."""
    change = np.zeros(6)
    change[5] = 2 * np.pi + 0.2 - q[5]
    return good(swing, q, change)


def _integrated(q: Array, qdd: Array) -> Trajectory:
    """Integrate accelerations of joint 1, (N,) [rad/s^2], one per sample."""
    n = len(qdd)
    speed = np.concatenate([[0.0], np.cumsum(qdd[:-1]) * STEP])
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) * STEP])
    times: Array = np.linspace(0.0, (n - 1) * STEP, n)
    first = np.eye(6)[0]
    return Trajectory(times, q + np.outer(way, first), np.outer(speed, first), np.outer(qdd, first))


def beside_the_arm(swing: Swing, q: Array) -> Trajectory:
    """Make a valid motion that starts off the commanded position."""
    return good(swing, q + BESIDE, np.full(6, 0.02))


def velocity_step(q: Array) -> Trajectory:
    """Make a motion with a velocity step of 0.5 rad/s."""
    qdd = np.zeros(60)
    motion = _integrated(q, qdd)
    way, speed = motion.q.copy(), motion.qd.copy()
    speed[10:, 0] = 0.5
    way[10:, 0] += 0.5 * STEP * np.arange(50)
    return replace(motion, q=way, qd=speed)


def acceleration_step(swing: Swing, q: Array) -> Trajectory:
    """Make a motion with twice the acceleration limit."""
    most = swing.config.arm.acceleration
    return _integrated(q, np.concatenate([np.zeros(5), np.full(5, 2 * most), np.full(5, -2 * most), np.zeros(5)]))


def jerk_step(swing: Swing, q: Array) -> Trajectory:
    """Make a motion that alternates between the acceleration limits without exceeding them."""
    most = 0.8 * swing.config.arm.acceleration
    return _integrated(q, np.concatenate([np.zeros(4), np.tile([most, most, -most, -most], 6), np.zeros(4)]))


def out_of_workspace(swing: Swing, q: Array) -> Trajectory:
    """Make a motion beyond the back of the workspace."""
    target = np.array([np.pi, -0.4, 0.0, q[3], q[4], q[5]])
    return good(swing, q, target - q)


def into_the_table(swing: Swing, q: Array) -> Trajectory:
    """Make a motion of the shoulder, backwards, that ends with the upper arm in the table.

    Hand and tool stay within the workspace: leaving it would be refused before.
    """
    change = np.zeros(6)
    change[1] = -2.2
    return good(swing, q, change)


def into_itself(swing: Swing, q: Array) -> Trajectory:
    """Make a motion of wrist 1 that bends the hand into the forearm, within the workspace."""
    change = np.zeros(6)
    change[3] = 2.2
    return good(swing, q, change)


def too_fast_for_a_handover(swing: Swing) -> Trajectory:
    """Return the strike, which is too fast for HANDOVER mode."""
    return swing.plan.strike
