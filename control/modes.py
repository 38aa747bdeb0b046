"""Modes of operation, and the speed of hand and tool along a trajectory."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum

import numpy as np

from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.collision_shapes import TOOL_JOINT
from toolee_robot.frames import Array
from toolee_robot.station import SupervisorConfig
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
    slower = float(np.max(carried_speed(trajectory, world))) / (0.99 * speed)
    if slower <= 1.0:
        return trajectory
    return replace(
        trajectory,
        times=trajectory.times * slower,
        qd=trajectory.qd / slower,
        qdd=trajectory.qdd / slower**2,
    )
