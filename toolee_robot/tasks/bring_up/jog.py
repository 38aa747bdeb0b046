"""Plans of small motions: joints by an angle, the flange along a straight line in a named frame."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from toolee_robot.control import plan_straight, slowed_to
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, BaseFrame
from toolee_robot.tasks.bring_up.caps import SlowStation
from toolee_robot.types import Trajectory

LONGEST = 2.0
"""Length of a straight motion above which it is a mistake, such as millimetres [m]."""

SLOWEST = 1e-4
"""Speed of a straight motion below which it would take hours [m/s]."""


class MotionFrame(StrEnum):
    """Frames in which a person gives the direction of a motion: those of the base, and the flange's own axes.

    TOOL: the flange's axes, since the robot's TCP is at the flange.
    """

    PENDANT_BASE = "pendant_base"
    BASE_LINK = "base_link"
    TOOL = "tool"

    def to_base(self, vector: Array, X_base_flange: Array) -> Array:
        """Express a vector in `base`.

        Args:
            vector: A direction or displacement in this frame, (3,).
            X_base_flange: Present pose of the flange, (4, 4).

        Returns:
            The vector in `base`, (3,).
        """
        if self is MotionFrame.TOOL:
            return np.asarray(X_base_flange[:3, :3] @ vector)
        return np.asarray(BaseFrame(self.value).X_base_this[:3, :3] @ vector)


def jog_joint(q: Array, joint: int, by: float) -> Array:
    """Compute the goal of a jog of one joint.

    Args:
        q: Present joint positions, (6,) [rad].
        joint: Number of the joint, 1 (base) to 6 (wrist 3).
        by: Change [rad].

    Returns:
        The joint positions, (6,) [rad].

    Raises:
        UserError: There is no such joint.
    """
    if not 1 <= joint <= 6:
        raise UserError(f"joint {joint}: give 1 (base) to 6 (wrist 3)", code="user.joint")
    goal = q.copy()
    goal[joint - 1] += by
    return goal


def plan_joints(slow: SlowStation, q: Array, q_goal: Array) -> Trajectory:
    """Plan a motion that is straight in joint space; it takes no way around anything.

    Args:
        slow: The station under its caps.
        q: Present joint positions, (6,) [rad].
        q_goal: Final joint positions, (6,) [rad].

    Returns:
        The trajectory, from rest to rest.

    Raises:
        UserError: The goal is not finite, or beyond a joint's range.
    """
    robot, config = slow.robot, slow.config
    if not (np.all(np.isfinite(q_goal)) and np.all(robot.arm.lower <= q_goal) and np.all(q_goal <= robot.arm.upper)):
        raise UserError(
            f"the joints would go to {np.round(q_goal, 3)} rad: outside their range, give radians",
            code="user.joint_positions",
        )
    arm = config.arm
    velocity = arm.transfer_velocity_scale * np.asarray(arm.velocity)
    limits = (np.full(6, value) for value in (arm.transfer_acceleration, min(arm.jerk, 10 * arm.transfer_acceleration)))
    return slowed_to(joint_move(q, q_goal, velocity, *limits), slow.world, config.supervisor.handover_speed)


def plan_line(
    slow: SlowStation,
    q: Array,
    vector: Array,
    frame: MotionFrame,
    speed: float | None = None,
) -> Trajectory:
    """Plan a straight motion of the flange with constant orientation.

    Args:
        slow: The station under its caps.
        q: Present joint positions, (6,) [rad].
        vector: Displacement, (3,) [m].
        frame: Frame of the displacement.
        speed: Largest speed [m/s]; None for the station's handover speed, which is never exceeded.

    Returns:
        The trajectory, from rest to rest.

    Raises:
        UserError: The displacement is no length between a tenth of a millimetre and LONGEST, or the speed not between
            SLOWEST and the handover speed.
        PlanningError: As `plan_straight`.
    """
    length = float(np.linalg.norm(vector)) if np.all(np.abs(vector) <= LONGEST) else np.inf
    if not 1e-4 <= length <= LONGEST:
        raise UserError(
            f"a straight motion of {length:.4g} m: give metres, 0.0001 to {LONGEST:g}, and a frame",
            code="user.displacement",
        )
    robot, config = slow.robot, slow.config
    top = config.supervisor.handover_speed
    if speed is not None and not SLOWEST <= speed <= top:
        raise UserError(f"a speed of {speed:g} m/s: give {SLOWEST:g} to {top:g}", code="user.speed")
    x, y, z = (frame.to_base(vector, robot.arm.fk(q)) / length).tolist()
    move = plan_straight(robot, config, slow.world, q, length, (x, y, z), top if speed is None else speed)
    return slowed_to(move, slow.world, top)
