"""Modes of operation and their speeds, and the final check of a trajectory against every limit."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum

import numpy as np

from toolee_robot.arm_data import JOINTS
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.collision_shapes import TOOL_JOINT
from toolee_robot.control.kinematics import ArmKinematics
from toolee_robot.errors import LimitError
from toolee_robot.frames import Array
from toolee_robot.station import ArmLimits, SceneConfig, SupervisorConfig
from toolee_robot.types import Trajectory


class Mode(StrEnum):
    """Modes of operation.

    HANDOVER: slow; a person may be in reach and holds the hold-to-run switch. UNATTENDED: fast; nobody is in reach.
    """

    HANDOVER = "handover"
    UNATTENDED = "unattended"

    def speed(self, config: SupervisorConfig) -> float:
        """Largest permitted speed of any point of hand and tool [m/s]."""
        return config.handover_speed if self is Mode.HANDOVER else config.unattended_speed


def carried_speed(trajectory: Trajectory, world: CollisionWorld) -> Array:
    """Speed of the fastest point of flange, hand and tool between successive samples.

    Hand and tool are represented by the centres of the spheres that cover them.

    Args:
        trajectory: Trajectory of N samples.
        world: Bodies of hand and tool.

    Returns:
        The speeds, (N - 1,) [m/s].
    """
    robot = world.robot
    R, p = robot.arm.joints(trajectory.q)
    points = [body.spheres[:, :3] for body in world.bodies if body.joint == TOOL_JOINT]
    points.append(robot.arm.X_joint6_flange[None, :3, 3])
    x = np.concatenate(points) @ np.swapaxes(R[:, 5], 1, 2) + p[:, 5, None]
    moved = np.diff(x, axis=0)
    length = np.sqrt(np.max(np.einsum("nsi,nsi->ns", moved, moved), axis=1))
    return np.asarray(length / np.diff(trajectory.times))


def slowed_to(trajectory: Trajectory, world: CollisionWorld, speed: float) -> Trajectory:
    """Scale the time of a trajectory so that hand and tool stay below a speed.

    Args:
        trajectory: The trajectory.
        world: Bodies of hand and tool.
        speed: Largest permitted speed [m/s].

    Returns:
        The slowed trajectory on the same path, or the given one if it is slow enough.
    """
    return slowed_by(trajectory, float(np.max(carried_speed(trajectory, world))) / (0.99 * speed))


def slowed_by(trajectory: Trajectory, slower: float) -> Trajectory:
    """Stretch a trajectory in time.

    Args:
        trajectory: The trajectory.
        slower: In how many times its time it is to be run.

    Returns:
        The slowed trajectory on the same path, or the given one where `slower` is 1 or less.
    """
    if slower <= 1.0:
        return trajectory
    return replace(
        trajectory,
        times=trajectory.times * slower,
        qd=trajectory.qd / slower,
        qdd=trajectory.qdd / slower**2,
    )


TOLERANCE = 1e-3
"""Relative tolerance of the comparisons, for rounding."""
ROUNDING = 1e-6
"""Residual of inverse kinematics, for positions [rad] and velocities [rad/s]."""
AXES = ("x", "y", "z")
LONGEST = 600.0
"""Longest motion [s]: one that lasts longer has its times in another unit, or stands for years before its end."""
REST = 1e-3
"""Joint speed that counts as rest [rad/s]."""


def check_trajectory(
    trajectory: Trajectory,
    arm: ArmKinematics,
    limits: ArmLimits,
    scene: SceneConfig,
    world: CollisionWorld | None = None,
) -> None:
    """Check a trajectory against the limits of joints and workspace.

    The limits are checked at the samples, and the samples are checked against each other: the change of position
    between two samples must agree with the velocities, and that of velocity with the accelerations, to within the error
    bounds of the trapezoidal rule for the jerk limit J and the sample period h (h^3 J / 12 for positions, h^2 J / 4 for
    velocities, h J for accelerations). A step between samples is thus detected.

    Args:
        trajectory: Trajectory of the 6 joints.
        arm: Kinematics and position limits of the arm.
        limits: Limits of velocity, acceleration and jerk.
        scene: Workspace of the flange.
        world: Bodies of hand and tool, and their workspace; None where the flange alone counts.

    Raises:
        LimitError: The trajectory is not finite, does not start and end at rest, or violates a limit; the code names
            the cause, such as `limit.velocity`. Hand and tool are checked as by `check_carried`.
    """
    t, q, qd, qdd = trajectory.times, trajectory.q, trajectory.qd, trajectory.qdd
    if q.shape[1] != 6:
        raise LimitError(f"the trajectory has {q.shape[1]} joints, the arm has 6", code="limit.joint_count")
    if not all(np.all(np.isfinite(x)) for x in (t, q, qd, qdd)):
        raise LimitError("the trajectory holds NaN or infinite values: nothing is sent", code="limit.not_finite")
    if trajectory.duration > LONGEST:
        raise LimitError(
            f"the trajectory lasts {trajectory.duration:.3g} s, {LONGEST:.0f} s are allowed: nothing is sent; give its "
            "times in seconds",
            code="limit.duration",
        )
    for where, row in (("start", 0), ("end", -1)):
        if np.max(np.abs(qd[row])) > REST:
            speed = np.max(np.abs(qd[row]))
            raise LimitError(f"the trajectory does not {where} at rest ({speed:.3f} rad/s)", code="limit.not_at_rest")
    velocity = np.asarray(limits.velocity)
    slack = TOLERANCE * (arm.upper - arm.lower)
    _within("position", "rad", q, arm.lower - slack, arm.upper + slack, t)
    _within("velocity", "rad/s", qd, -velocity * (1 + TOLERANCE), velocity * (1 + TOLERANCE), t)
    top = np.asarray(limits.acceleration) * (1 + TOLERANCE)
    _within("acceleration", "rad/s^2", qdd, -top, top, t)
    _no_step(trajectory, velocity, limits.jerk * (1 + TOLERANCE))
    _within(
        "flange position",
        "m",
        arm.fk(q)[:, :3, 3],
        np.array(scene.workspace_lower),
        np.array(scene.workspace_upper),
        t,
        axes=AXES,
    )
    if world is not None:
        check_carried(q, t, world)


def check_carried(q: Array, times: Array, world: CollisionWorld) -> None:
    """Check hand and tool against the workspace.

    Args:
        q: Joint positions of a motion's samples, (N, 6) [rad].
        times: Their times, (N,) [s].
        world: Bodies of hand and tool, and their workspace.

    Raises:
        LimitError: A body leaves the workspace; code `limit.carried_position`. One that is slightly outside at the
            start must not go farther out (`CollisionWorld.bounds`), and be inside at the end.
    """
    for name, low, high in world.extremes(q):
        on_the_way = world.bounds(low[0], high[0])
        for rows, (lower, upper) in ((slice(None), on_the_way), (slice(-1, None), world.workspace)):
            for x in (low, high):
                what = f"position of the {name}"
                _within(what, "m", x[rows], lower, upper, times[rows], AXES, "limit.carried_position")


def _no_step(trajectory: Trajectory, velocity: Array, jerk: float) -> None:
    t, q, qd, qdd = trajectory.times, trajectory.q, trajectory.qd, trajectory.qdd
    h = np.diff(t)[:, None]
    _within("velocity between samples", "rad/s", np.diff(q, axis=0) / h, -1.01 * velocity, 1.01 * velocity, t)
    # At rest before and after: an acceleration at either end would be a step.
    change = np.diff(np.vstack([np.zeros(6), qdd, np.zeros(6)]), axis=0) / np.vstack([h[:1], h, h[-1:]])
    _within("jerk", "rad/s^3", change, np.full(6, -jerk), np.full(6, jerk), np.append(t, t[-1]))
    for what, unit, x, slope, allowed in (
        ("position", "rad", q, qd, h**3 * jerk / 12 + ROUNDING),
        ("velocity", "rad/s", qd, qdd, h**2 * jerk / 4 + ROUNDING),
    ):
        gap = np.diff(x, axis=0) - 0.5 * h * (slope[1:] + slope[:-1])
        limit = np.broadcast_to(allowed, gap.shape)
        _within(f"step in {what}", unit, gap, -limit, limit, t)


def _within(
    what: str,
    unit: str,
    x: Array,
    lower: Array,
    upper: Array,
    t: Array,
    axes: tuple[str, ...] | None = None,
    code: str | None = None,
) -> None:
    """Raise LimitError for the first value of x, (N, n), outside its bounds; bounds are (n,) or (N, n)."""
    bad = (x < lower) | (x > upper)
    if not np.any(bad):
        return
    lower, upper = np.broadcast_to(lower, x.shape), np.broadcast_to(upper, x.shape)
    row, column = np.argwhere(bad)[0]
    name = axes[column] if axes else f"joint {column + 1} ({JOINTS[column]})"
    raise LimitError(
        f"{what} of {name} is {x[row, column]:.5g} {unit} at {t[row]:.3f} s, outside "
        f"[{lower[row, column]:.3g}, {upper[row, column]:.3g}]: nothing is sent; slow down or move the target",
        code=code or f"limit.{what.replace(' ', '_')}",
    )
