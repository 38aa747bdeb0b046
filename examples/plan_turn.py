"""Plan a turn about a tool's own axis: the motion of `turn_screw.py`."""

from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from toolee_robot import StationConfig
from toolee_robot.control.collision import BRAKE_EXEMPT
from toolee_robot.control.kinematics import solve
from toolee_robot.control.planning.timing import travel_profile
from toolee_robot.control.planning.transfer import plan_transfer
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import PlanningError, UnreachableError
from toolee_robot.frames import Array, inverse, rotation_z, transform
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.types import Trajectory

CLEARANCE = 0.015  # [m]
HEIGHT = 0.03  # [m] over the screw, from where the tip goes straight down
STARTS = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)  # a round tip may begin at any angle [rad]


def plan_turn(
    robot: RobotModel, config: StationConfig, motions: Motions, held: HeldTool, X_base_screw: Array, angle: float
) -> tuple[Trajectory, Trajectory]:
    """The way to a place HEIGHT above the screw, and the turn of the tip on it. Raises UnreachableError."""
    world, up = motions.world(held), transform(p=[0.0, 0.0, HEIGHT])
    for turn in turns(robot, motions, held, X_base_screw, angle):
        inside = np.all((turn.q > robot.arm.lower) & (turn.q < robot.arm.upper))
        if inside and np.abs(turn.qd).max() < 1.0 and world.free(turn.q[::20], CLEARANCE, BRAKE_EXEMPT):
            with suppress(PlanningError):  # this one cannot be reached: the next
                above = robot.ik.branches(up @ robot.arm.fk(turn.q[0]))[robot.ik.branch_of(turn.q[0])]
                if np.all(np.isfinite(above)):
                    goal = robot.ik.unwrap(above, turn.q[0])
                    return plan_transfer(robot, config, world, motions.q, goal), turn
    raise UnreachableError("the screw cannot be turned there: move it nearer to the middle of the arm's reach")


def turns(
    robot: RobotModel, motions: Motions, held: HeldTool, X_base_screw: Array, angle: float
) -> Iterator[Trajectory]:
    """The turn from every start and on every branch of the inverse kinematics, collisions not considered."""
    X_ee_flange = inverse(robot.X_flange_hand(motions.q_hand) @ held.X_hand_ee)
    axis, origin = X_base_screw[:3, 2], X_base_screw[:3, 3]
    profile = travel_profile(0.0, angle, speed=0.5, acceleration=1.0, jerk=10.0)  # [rad/s], [rad/s^2], [rad/s^3]
    for start in STARTS:
        Xs = np.stack([X_base_screw @ transform(rotation_z(start + s)) @ X_ee_flange for s in profile.s])
        paths = robot.ik.branches_along(np.repeat(Xs[None], 8, 0), np.arange(8), np.repeat(motions.q[None], 8, 0))
        for q in paths[np.isfinite(paths).all(axis=(1, 2))]:
            X_base_flange, J = robot.arm.fk_jacobian(q)
            linear = np.cross(axis, X_base_flange[:, :3, 3] - origin)
            per_radian = np.concatenate([linear, np.broadcast_to(axis, linear.shape)], axis=1)
            qd = solve(J, per_radian) * profile.v[:, None]
            yield Trajectory(profile.times, q, qd, np.gradient(qd, profile.times, axis=0))


if __name__ == "__main__":
    print(__doc__)
