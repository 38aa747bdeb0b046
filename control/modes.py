"""The two ways in which the arm may move, and how fast what it carries moves."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum

import numpy as np

from toolee_robot.config import SupervisorConfig
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.collision_shapes import TOOL_JOINT
from toolee_robot.frames import Array
from toolee_robot.types import Trajectory


class Mode(StrEnum):
    """HANDOVER: a person may be in reach and watches; slow. UNATTENDED: nobody is in reach; fast."""

    HANDOVER = "handover"
    UNATTENDED = "unattended"

    def speed(self, config: SupervisorConfig) -> float:
        """[m/s] The most that any point of hand and tool may move with."""
        return config.handover_speed if self is Mode.HANDOVER else config.unattended_speed


def carried_speed(trajectory: Trajectory, world: CollisionWorld) -> Array:
    """(N - 1,) [m/s]: of the fastest point of hand and tool between two samples each (the centres of the spheres that
    cover them), and of the flange."""
    robot = world.robot
    R, p = robot.arm.joints(trajectory.q)
    points = [body.spheres[:, :3] for body in world.bodies if body.joint == TOOL_JOINT]
    points.append(robot.arm.X_joint6_flange[None, :3, 3])
    x = np.concatenate(points) @ np.swapaxes(R[:, 5], 1, 2) + p[:, 5, None]
    moved = np.diff(x, axis=0)
    length = np.sqrt(np.max(np.einsum("nsi,nsi->ns", moved, moved), axis=1))
    return np.asarray(length / np.diff(trajectory.times))


def slowed_to(trajectory: Trajectory, world: CollisionWorld, speed: float) -> Trajectory:
    """The same path, slowed as a whole until nothing carried is faster than `speed` [m/s]; itself where nothing is."""
    slower = float(np.max(carried_speed(trajectory, world))) / (0.99 * speed)
    if slower <= 1.0:
        return trajectory
    return replace(
        trajectory,
        times=trajectory.times * slower,
        qd=trajectory.qd / slower,
        qdd=trajectory.qdd / slower**2,
    )
