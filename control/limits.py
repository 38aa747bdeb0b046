"""The last check before a trajectory goes out: finite, at rest at its start, inside every limit."""

from __future__ import annotations

import numpy as np

from toolee_robot.config import ArmLimits, SceneConfig
from toolee_robot.control.kinematics import ArmKinematics
from toolee_robot.errors import LimitError
from toolee_robot.frames import Array
from toolee_robot.types import Trajectory

TOLERANCE = 1e-3
"""Relative slack of the comparisons: rounding is no violation."""


def check_trajectory(
    trajectory: Trajectory,
    arm: ArmKinematics,
    limits: ArmLimits,
    scene: SceneConfig,
    *,
    starts_at_rest: bool = True,
) -> None:
    """Raise LimitError unless the trajectory is finite, consistent, within the joints' position, velocity and
    acceleration limits and keeps the flange inside the workspace.

    Velocities and accelerations are checked as given and as finite differences of the positions, so a step cannot
    hide between samples.
    """
    t, q, qd, qdd = trajectory.times, trajectory.q, trajectory.qd, trajectory.qdd
    if q.shape[1] != 6:
        raise LimitError(f"the trajectory has {q.shape[1]} joints, the arm has 6")
    if not all(np.all(np.isfinite(x)) for x in (t, q, qd, qdd)):
        raise LimitError("the trajectory holds NaN or infinite values: nothing is sent")
    if starts_at_rest and np.max(np.abs(qd[0])) > 1e-3:
        raise LimitError(f"the trajectory does not start at rest (joint speed {np.max(np.abs(qd[0])):.3f} rad/s)")
    velocity = np.asarray(limits.velocity)
    slack = TOLERANCE * (arm.upper - arm.lower)
    _within("position", "rad", q, arm.lower - slack, arm.upper + slack, t)
    _within("velocity", "rad/s", qd, -velocity * (1 + TOLERANCE), velocity * (1 + TOLERANCE), t)
    top = np.full(6, limits.acceleration * (1 + TOLERANCE))
    _within("acceleration", "rad/s^2", qdd, -top, top, t)
    # What the arm would be asked to do between two samples; a cubic's slope exceeds neither by more than this slack.
    slope = np.diff(q, axis=0) / np.diff(t)[:, None]
    _within("velocity between samples", "rad/s", slope, -velocity * 1.01, velocity * 1.01, t)
    change = np.diff(qd, axis=0) / np.diff(t)[:, None]
    _within("acceleration between samples", "rad/s^2", change, -top * 1.02 - 0.05, top * 1.02 + 0.05, t)
    p = arm.fk(q)[:, :3, 3]
    _within(
        "flange position",
        "m",
        p,
        np.array(scene.workspace_lower),
        np.array(scene.workspace_upper),
        t,
        axes=("x", "y", "z"),
    )


def _within(
    what: str, unit: str, x: Array, lower: Array, upper: Array, t: Array, axes: tuple[str, ...] | None = None
) -> None:
    bad = (x < lower) | (x > upper)
    if not np.any(bad):
        return
    row, column = np.argwhere(bad)[0]
    name = axes[column] if axes else f"joint {column + 1}"
    raise LimitError(
        f"{what} of {name} is {x[row, column]:.3f} {unit} at {t[row]:.3f} s, outside "
        f"[{lower[column]:.3f}, {upper[column]:.3f}]: nothing is sent; slow down or move the target"
    )
