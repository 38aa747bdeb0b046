"""The robot: a UR10 with a Shadow Hand (right), built from model packages of the package registry.

    from toolee_robot.robots import load_robot, nominal_X_hand_tool
    robot = load_robot()                  # robot.urdf_path works in Pinocchio and in pybullet
    X_flange_hand = robot.X_flange_hand(q_hand)
    hand_link_poses(robot.hand_closed)    # plain numpy, link -> X_hand_link

Nothing here imports a physics engine or Pinocchio.
"""

from toolee_robot.robots.description import (
    ARM_JOINTS,
    FLANGE_FRAME,
    HAND_FRAME,
    HAND_JOINTS,
    WRIST_JOINTS,
    RobotDescription,
    arm_link_poses,
    arm_meshes,
    hand_link_poses,
    hand_meshes,
    load_robot,
)
from toolee_robot.robots.grasp import FINGERS, finger_of, hand_posture, nominal_X_hand_tool
from toolee_robot.robots.wrap import wrap_fingers

__all__ = [
    "ARM_JOINTS",
    "FINGERS",
    "FLANGE_FRAME",
    "HAND_FRAME",
    "HAND_JOINTS",
    "WRIST_JOINTS",
    "RobotDescription",
    "arm_link_poses",
    "arm_meshes",
    "finger_of",
    "hand_link_poses",
    "hand_meshes",
    "hand_posture",
    "load_robot",
    "nominal_X_hand_tool",
    "wrap_fingers",
]
