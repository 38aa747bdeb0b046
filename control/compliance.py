"""How far a mount yields while the arm brakes behind the contact."""

from __future__ import annotations

import numpy as np

from toolee_robot.control.robot_model import RobotModel
from toolee_robot.frames import Array, inverse


def yield_lever(robot: RobotModel, q_hand: Array, X_flange_ee: Array) -> float | None:
    """Distance of the face's centre from the yielding joint's axis, across the direction of the strike.

    Args:
        robot: Kinematic model of arm and hand.
        q_hand: Joint positions of the hand, wrist first, (n,) [rad].
        X_flange_ee: Pose of the end effector in the flange, (4, 4); it strikes along its z axis.

    Returns:
        The distance [m]; None where nothing yields.
    """
    description = robot.description
    hand = description.hand
    if hand.yielding is None:
        return None
    link = next(link for link in hand.tree.links if link.joint == hand.joints[hand.yielding])
    assert link.axis is not None, "a wrist joint turns"
    poses = description.link_poses(np.zeros(6), q_hand)
    X_flange_link = inverse(poses[description.flange_frame]) @ poses[link.name]
    turning = np.cross(X_flange_link[:3, :3] @ link.axis, X_flange_ee[:3, 3] - X_flange_link[:3, 3])
    return float(abs(turning @ X_flange_ee[:3, 2]))


def yield_length(robot: RobotModel, q_hand: Array, X_flange_ee: Array) -> float:
    """Way that the arm can go on behind the contact, the face standing still, before a mount meets its end stop.

    Args:
        robot: Kinematic model of arm and hand.
        q_hand: Joint positions of the hand, wrist first, (n,) [rad].
        X_flange_ee: Pose of the end effector in the flange, (4, 4).

    Returns:
        The way [m]; infinite for a hand, whose fingers give way when its wrist cannot.
    """
    lever, hand = yield_lever(robot, q_hand, X_flange_ee), robot.description.hand
    if lever is None or hand.yielding is None or not hand.clamps:
        return np.inf
    return lever * float(robot.description.upper[6 + hand.yielding] - hand.wrist[hand.yielding].rest)
