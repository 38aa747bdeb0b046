"""Choose where to turn a tool about its own axis: the start of `turn_screw.py`'s turn."""

from contextlib import suppress

import numpy as np

from toolee_robot import StationConfig
from toolee_robot.control.planning.transfer import plan_transfer
from toolee_robot.control.planning.turn import Stroke, places
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import PlanningError, UnreachableError
from toolee_robot.frames import Array, rotation_z, transform
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.types import Trajectory

HEIGHT = 0.03  # [m] over the screw, from where the tip goes straight down
STARTS = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)  # a round tip may begin at any angle [rad]


def plan_place(
    robot: RobotModel, config: StationConfig, motions: Motions, held: HeldTool, X_base_screw: Array, angle: float
) -> Trajectory:
    """The way to a place HEIGHT above the screw, from where the tip can be turned. Raises UnreachableError."""
    world, axis, point = motions.world(held), X_base_screw[:3, 2], X_base_screw[:3, 3]
    X_flange_ee = robot.X_flange_hand(motions.q_hand) @ held.X_hand_ee
    starts = [X_base_screw @ transform(rotation_z(start)) for start in STARTS]
    strokes = [Stroke(X, np.zeros(3), axis, point, angle, HEIGHT) for X in starts]
    for _, q in places(robot, world, motions.q, X_flange_ee, strokes):
        with suppress(PlanningError):  # this one cannot be reached: the next
            return plan_transfer(robot, config, world, motions.q, q)
    raise UnreachableError("the screw cannot be turned there: move it nearer to the middle of the arm's reach")


if __name__ == "__main__":
    print(__doc__)
