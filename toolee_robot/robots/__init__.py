"""The robot: a UR10 or UR10e with a hand, built from the model files in `models`.

    from toolee_robot.robots import SHADOW_HAND, load_robot
    robot = load_robot()                  # robot.urdf is for Pinocchio and pybullet
    X_flange_hand = robot.X_flange_hand(q_hand)
    SHADOW_HAND.grasp.X_hand_tool(0.016)  # nominal pose of a handle of this radius [m]
    SHADOW_HAND.link_poses(q_hand)        # plain numpy, link -> X_hand_link

Each hand is a `HandModel` record in `toolee_robot.robots.hands`. This package imports neither a physics engine nor
Pinocchio.
"""

from toolee_robot.robots.description import (
    ARM_JOINTS,
    SHAPE_MARGIN,
    RobotDescription,
    arm_link_poses,
    arm_meshes,
    load_robot,
)
from toolee_robot.robots.hands import (
    HANDS,
    MOUNT,
    PALM,
    SHADOW_HAND,
    HandChoice,
    HandModel,
    NominalGrasp,
    WristJoint,
    find_hand,
    hand_model,
)
from toolee_robot.robots.hands.model import wrap_fingers
from toolee_robot.robots.tree import FLANGE_FRAME
from toolee_robot.robots.urdf import write_urdf
