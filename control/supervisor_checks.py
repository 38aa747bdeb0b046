"""What the supervisor asks of a trajectory and of the arm before it moves. Each check raises, none changes anything."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from toolee_robot.config import StationConfig
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.limits import check_trajectory
from toolee_robot.control.modes import Mode, carried_speed
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import CollisionError, LimitError, NotReadyError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmState, ArmStatus
from toolee_robot.types import Trajectory

STEP = 0.015
"""[rad] at most between two configurations that are checked for collisions: 2 cm at full reach."""
CLEARANCE = 0.002
"""[m] that must be left at these, unless the motion starts nearer: then it may not come nearer still."""
OFF_COMMAND = 0.03
"""[rad] An arm that stands further from where it was commanded has been moved, or gives way."""
AT_REST = 0.05
"""[rad/s]"""


def is_finite(trajectory: Trajectory) -> bool:
    """No NaN and no infinity anywhere in it."""
    return all(np.all(np.isfinite(x)) for x in (trajectory.times, trajectory.q, trajectory.qd, trajectory.qdd))


def check_limits(trajectory: Trajectory, robot: RobotModel, config: StationConfig) -> None:
    """Raise LimitError: not finite, or outside the configuration's limits, the model's, or the workspace."""
    velocity = np.minimum(config.arm.velocity, robot.description.velocity[:6])
    limits = replace(config.arm, velocity=tuple(velocity.tolist()))
    check_trajectory(trajectory, robot.arm, limits, config.scene)


def check_speed(trajectory: Trajectory, world: CollisionWorld, speed: float, mode: Mode) -> None:
    """Raise LimitError when anything carried is faster than `speed` [m/s]."""
    fastest = carried_speed(trajectory, world)
    if np.max(fastest) > speed:
        raise LimitError(
            f"hand or tool would move at {np.max(fastest):.2f} m/s at {trajectory.times[np.argmax(fastest)]:.2f} s, "
            f"{speed:.2f} m/s are allowed in {mode} mode: nothing is sent; plan a slower motion"
        )


def check_ready(state: ArmState) -> None:
    """Raise NotReadyError unless the robot's own safety system lets it move and it stands still."""
    if state.status is not ArmStatus.READY:
        raise NotReadyError(f"the robot is in {state.status.replace('_', ' ')}: a person must make it ready there")
    fastest = float(np.max(np.abs(state.joints.qd)))
    if not fastest < AT_REST:  # NaN included
        raise NotReadyError(f"the arm still moves ({fastest:.2f} rad/s): wait until it stands")


def check_place(state: ArmState) -> None:
    """Raise LimitError unless the arm stands where it was commanded."""
    off = float(np.max(np.abs(state.joints.q - state.q_commanded)))
    if not off <= OFF_COMMAND:  # NaN included
        raise LimitError(
            f"the arm stands {off:.3f} rad from where it was commanded (allowed {OFF_COMMAND}): has somebody moved it, "
            "or does it lean on something? Free it, reset it, then plan from its present state"
        )


def check_clear(q: Array, world: CollisionWorld, exempt: frozenset[tuple[str, str]]) -> None:
    """Raise CollisionError when anything touches anything on the way through q (N, 6)."""
    along = np.concatenate([[0.0], np.cumsum(np.max(np.abs(np.diff(q, axis=0)), axis=1))])
    count = max(2, int(np.ceil(along[-1] / STEP)) + 1)
    rows = np.unique(np.searchsorted(along, np.linspace(0.0, along[-1], count)).clip(0, len(q) - 1))
    start = world.closest(q[0], CLEARANCE, exempt).distance
    need = min(CLEARANCE, start - 1e-6)
    if need > 0.0 and world.free(q[rows], need, exempt):
        return
    closest = world.closest(q[rows], CLEARANCE, exempt)
    raise CollisionError(
        f"the motion would bring {closest} together: nothing was moved; clear the way or move the target"
    )
