"""Planning of straight motions: to the start of a guarded touch, and along any direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from toolee_robot.control.collision import BRAKE_EXEMPT, CollisionWorld
from toolee_robot.control.limits import check_trajectory
from toolee_robot.control.planning.line import Line
from toolee_robot.control.planning.timing import concatenate, travel_profile
from toolee_robot.control.planning.transfer import NEED, plan_transfer
from toolee_robot.control.records import StrikePlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import UnreachableError
from toolee_robot.frames import Array
from toolee_robot.station import StationConfig
from toolee_robot.types import Trajectory

LOWERING_SPEED = 0.5
"""Largest speed of the way down to where a guarded touch begins [m/s]."""
HIGHEST_RISE, RISE_STEP = 0.10, 0.005
"""How far a tool rises from among bodies at most, and in which steps it is tried [m]."""


def plan_over_nail(
    robot: RobotModel, config: StationConfig, world: CollisionWorld, q_start: Array, plan: StrikePlan, before: float
) -> Trajectory:
    """Plan a motion to rest on a strike's line, where a guarded touch begins.

    Args:
        robot: Kinematic model of arm and hand.
        config: Configuration of the station.
        world: The collision model.
        q_start: Present joint positions of the arm, at rest, (6,) [rad].
        plan: The strike.
        before: Distance above the expected contact [m].

    Returns:
        The trajectory, checked for collisions and limits, at rest at both ends.

    Raises:
        PlanningError: As `plan_transfer` and `plan_straight`.
    """
    line, high = _line_of(robot, plan), min(plan.run_up, config.strike.run_up)
    lower = _travel(line, config, -high, -before, LOWERING_SPEED)
    approach = concatenate(plan_transfer(robot, config, world, q_start, lower.q[0]), lower)
    check_trajectory(approach, robot.arm, config.arm, config.scene, world)
    return approach


def rise_to_clear(robot: RobotModel, world: CollisionWorld, q_start: Array) -> float:
    """Find how far to rise straight up until a transfer may begin.

    Args:
        robot: Kinematic model of arm and hand.
        world: The collision model.
        q_start: Present joint positions of the arm, at rest, (6,) [rad].

    Returns:
        The least height at which all bodies are as clear of each other as on a transfer [m]; that at which they are
        clearest where there is none within HIGHEST_RISE.

    Raises:
        UnreachableError: The arm is in a singularity.
    """
    line = Line.through(robot.ik, q_start, np.array([0.0, 0.0, 1.0]))
    best, most = 0.0, world.closest(q_start, NEED).distance
    for height in np.arange(RISE_STEP, HIGHEST_RISE, RISE_STEP):
        if most >= NEED:
            break
        try:
            distance = world.closest(line.q(np.array([height])), NEED).distance
        except UnreachableError:
            break
        if distance > most:
            best, most = float(height), distance
    return best


def plan_straight(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    q_start: Array,
    length: float,
    direction: ArrayLike = (0.0, 0.0, 1.0),
    speed: float = 0.25,
    share: float | None = None,
) -> Trajectory:
    """Plan a straight motion of the flange with constant orientation, from rest to rest.

    Args:
        robot: Kinematic model of arm and hand.
        config: Configuration of the station.
        world: The collision model; the tool may touch block and stand.
        q_start: Present joint positions of the arm, at rest, (6,) [rad].
        length: Length of the motion [m]; negative against the direction.
        direction: Direction in `base`; up by default.
        speed: Largest speed [m/s].
        share: Largest velocity and acceleration of the joints as a share of a strike's; those of transfers if None.

    Returns:
        The trajectory, checked for collisions and limits, at rest at both ends.

    Raises:
        CollisionError: Bodies would touch.
        LimitError: The trajectory violates a limit.
        UnreachableError: The line is out of reach or singular.
    """
    line = Line.through(robot.ik, q_start, np.asarray(direction, dtype=np.float64))
    move = _travel(line, config, 0.0, length, speed, share)
    world.check(move.q[:: max(1, len(move.q) // 20)], 0.0, "the straight move", BRAKE_EXEMPT)
    check_trajectory(move, robot.arm, config.arm, config.scene, world)
    return move


def _travel(
    line: Line,
    config: StationConfig,
    start: float,
    end: float,
    speed: float = 0.25,
    share: float | None = None,
) -> Trajectory:
    """Build a motion along the line from rest to rest, with the limits of transfers or a share of a strike's."""
    arm = config.arm
    scale = arm.transfer_velocity_scale if share is None else share
    acceleration = arm.transfer_acceleration if share is None else share * arm.acceleration
    q = line.q(np.linspace(start, end, 9))
    limits = line.travel_limits(q, scale * np.asarray(arm.velocity), acceleration, arm.jerk, speed)
    return line.timed(travel_profile(start, end, limits.speed, limits.acceleration, limits.jerk))


def _line_of(robot: RobotModel, plan: StrikePlan) -> Line:
    X_base_flange = robot.arm.fk(plan.q_contact)
    return Line(
        robot.ik, X_base_flange, plan.X_base_ee_contact[:3, 2], robot.ik.branch_of(plan.q_contact), plan.q_contact
    )
