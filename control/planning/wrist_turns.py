"""Planning of the postures in which the arm weighs a tool: the wrist turns, and the rest of the arm stays."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.planning.transfer import NEED, STEP, plan_transfer
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.control.tool_weight import WeighingPrior, expected_covariance
from toolee_robot.errors import CollisionError, LimitError
from toolee_robot.frames import Array
from toolee_robot.station import StationConfig
from toolee_robot.types import Trajectory

TURNS = (
    np.deg2rad([0.0, 30.0, -30.0, 60.0, -60.0]),
    np.deg2rad([0.0, 40.0, -40.0, 80.0, -80.0]),
    np.deg2rad([0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0]),
)
"""Turns of wrist 1, 2 and 3 from the first posture that are tried [rad]."""
MASS, MOMENT = 0.1, 0.02
"""Errors of the mass [kg] and of its moments [kg m] that count alike."""
TRAVEL = 0.02
"""A posture that is 1 rad farther away must be so much better, as a share."""


def plan_wrist_turns(
    robot: RobotModel,
    config: StationConfig,
    world: CollisionWorld,
    q_start: Array,
    noise: tuple[float, float],
    prior: WeighingPrior,
    count: int,
    first: Sequence[Array] | None = None,
) -> list[Trajectory]:
    """Plan motions of the wrist to postures that together tell a tool's weight best, one after the other.

    Each is chosen by what the readings up to it are expected to tell, and reached on a straight way in joint space.

    Args:
        robot: Kinematic model of arm and hand.
        config: Configuration of the station.
        world: Collision model.
        q_start: Joint positions of the first reading, with and without the tool, (6,) [rad].
        noise: Standard deviation of a reading's mean, per axis: force [N] and torque [Nm].
        prior: What is known before.
        count: Largest number of postures.
        first: Postures that come first where they can be reached, (6,) [rad] each: there the empty hand was felt, as in
            `q_start`. None: it will be felt in `q_start` and in all that are chosen.

    Returns:
        The motions, fewer than `count` where no further posture is free.
    """
    goals = np.array([q_start + np.array([0.0, 0.0, 0.0, *turn]) for turn in product(*TURNS)][1:])
    goals = goals[np.all((goals > robot.arm.lower) & (goals < robot.arm.upper), axis=-1)]
    goals = goals[[world.free(q, NEED) and world.inside(q[None]) for q in goals]]
    gravity, scale = config.arm.gravity, np.array([MASS, MOMENT, MOMENT, MOMENT])
    Rs_goal = robot.arm.fk(goals)[:, :3, :3] if len(goals) else np.empty((0, 3, 3))
    Rs, here, motions = [robot.arm.fk(q_start)[:3, :3]], q_start, list[Trajectory]()
    for goal in first or ():
        free = world.free(goal, NEED) and world.inside(goal[None])
        if free and (motion := _straight(robot, config, world, here, goal)) is not None:
            motions.append(motion)
            here = goal
            Rs.append(robot.arm.fk(goal)[:3, :3])
    felt = np.array([q_start, *(motion.q[-1] for motion in motions)])
    left = {i for i, goal in enumerate(goals) if np.max(np.abs(felt - goal), axis=1).min() > STEP}
    while left and len(motions) < count:
        pairs = len(felt) if first is not None else len(Rs) + 1
        cost = {
            i: (1.0 + TRAVEL * float(np.max(np.abs(goals[i] - here))))
            * float(np.sum(np.diag(expected_covariance([*Rs, Rs_goal[i]], pairs, gravity, noise, prior)) / scale**2))
            for i in left
        }
        for i in sorted(left, key=cost.__getitem__):
            if (motion := _straight(robot, config, world, here, goals[i])) is not None:
                break
        else:
            return motions
        left.remove(i)
        motions.append(motion)
        here = goals[i]
        Rs.append(Rs_goal[i])
    return motions


def _straight(
    robot: RobotModel, config: StationConfig, world: CollisionWorld, start: Array, goal: Array
) -> Trajectory | None:
    """A motion on the straight way in joint space; None where that is not free."""
    steps = max(2, int(np.ceil(np.max(np.abs(goal - start)) / STEP)) + 1)
    way = start + np.linspace(0.0, 1.0, steps)[:, None] * (goal - start)
    need = min(NEED, world.closest(start, NEED).distance) - 1e-6
    if not (world.free(way, max(need, 0.0)) and world.inside(way, start)):
        return None
    try:
        return plan_transfer(robot, config, world, start, goal)
    except (CollisionError, LimitError):
        return None
