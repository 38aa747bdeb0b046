"""Slow motions of a bring-up: joints by an angle, the flange along a line, to a place of the station; all under caps.

    slow = SlowStation.of(load_station(Path("lab.yaml")), Caps())
    with open_arm(slow.config, host, person) as arm:
        arm.execute(plan_joints(slow, arm.state().q_commanded, q_goal))

Planner, supervisor and driver get the station under its caps, so none of them knows any other limit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Self

import numpy as np

from toolee_robot.control import (
    CollisionWorld,
    RobotModel,
    plan_handover,
    plan_straight,
    plan_strike,
    plan_transfer,
    plan_views,
    slowed_to,
)
from toolee_robot.control.planning.timing import joint_move
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, BaseFrame
from toolee_robot.station import STOP_ROOM, StationConfig
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tools import NAIL_DRIVERS, make_tool
from toolee_robot.types import Trajectory

SPEED, ACCELERATION = 0.1, 1.0
"""Caps of every joint that hold unless a person raises them [rad/s], [rad/s^2]."""
LEAST_SPEED, LEAST_ACCELERATION = 1e-3, 1e-2
"""Caps below which nothing useful moves [rad/s], [rad/s^2]."""
RAMP = 0.1
"""Time in which a jerk-limited ramp reaches the cap of the acceleration, and a stop ends from the cap of the speed
[s]."""


@dataclass(frozen=True)
class Caps:
    """Caps of a bring-up's motions.

    Attributes:
        speed: Largest speed of every joint [rad/s].
        acceleration: Largest acceleration of every planned motion [rad/s^2]. A stop takes 4/3 of it, and more if only
            the speed was raised: from the cap of the speed it still ends within RAMP.

    Raises:
        UserError: A cap is no number, or smaller than anything useful.
    """

    speed: float = SPEED
    acceleration: float = ACCELERATION

    def __post_init__(self) -> None:
        for name, value, least in (
            ("speed", self.speed, LEAST_SPEED),
            ("acceleration", self.acceleration, LEAST_ACCELERATION),
        ):
            if not (math.isfinite(value) and value >= least):
                raise UserError(f"the {name} limit is {value}: give a number of at least {least:g}")

    def apply(self, config: StationConfig) -> StationConfig:
        """Lower the limits of a station's arm.

        Args:
            config: Configuration of the station.

        Returns:
            The station with these caps as limits; none of its own limits is raised.
        """
        arm = config.arm
        velocity = np.minimum(arm.velocity, self.speed)
        transfer = float(np.min(arm.transfer_velocity_scale * np.asarray(arm.velocity) / velocity))
        acceleration = min(*arm.acceleration, arm.transfer_acceleration, self.acceleration)
        # A stop takes STOP_ROOM of `acceleration`. What is planned here keeps to `transfer_acceleration`.
        braking = min(*arm.acceleration, max(acceleration, float(np.max(velocity)) / (STOP_ROOM * RAMP)))
        a, b, c, d, e, f = velocity.tolist()
        limits = replace(
            arm,
            velocity=(a, b, c, d, e, f),
            acceleration=(braking,) * 6,
            jerk=min(arm.jerk, acceleration / RAMP),
            transfer_velocity_scale=min(1.0, transfer),
            transfer_acceleration=acceleration,
        )
        return replace(config, arm=limits)


@dataclass(frozen=True)
class SlowStation:
    """A station under caps, with its hand open and empty.

    Attributes:
        station: The station's own configuration.
        config: The same with the caps as limits.
        robot: Kinematic model of arm and hand.
        world: The collision model.
    """

    station: StationConfig
    config: StationConfig
    robot: RobotModel
    world: CollisionWorld

    @classmethod
    def of(cls, station: StationConfig, caps: Caps) -> Self:
        """Put a station under caps.

        Args:
            station: Configuration of the station.
            caps: The caps.

        Returns:
            The station under them.

        Raises:
            ConfigError: The hand is unknown.
        """
        config, robot = caps.apply(station), RobotModel.of_station(station)
        return cls(station, config, robot, CollisionWorld(robot, config, robot.description.hand_open))


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
        raise UserError(f"joint {joint}: give 1 (base) to 6 (wrist 3)")
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
            f"the joints would go to {np.round(q_goal, 3)} rad, which is outside their range. Give radians",
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
        raise UserError(f"a straight motion of {length:.4g} m: give 0.0001 to {LONGEST:g} m, and a frame")
    robot, config = slow.robot, slow.config
    top = config.supervisor.handover_speed
    if speed is not None and not SLOWEST <= speed <= top:
        raise UserError(f"a speed of {speed:g} m/s: give {SLOWEST:g} to {top:g}")
    x, y, z = (frame.to_base(vector, robot.arm.fk(q)) / length).tolist()
    move = plan_straight(robot, config, slow.world, q, length, (x, y, z), top if speed is None else speed)
    return slowed_to(move, slow.world, top)


class Place(StrEnum):
    """Places of a station that a job visits.

    HOME: `scene.home`. HANDOVER: where a tool is handed over. VIEW: where the camera would look at a tool in the hand.
    NAIL: where a strike would begin, over the nail.
    """

    HOME = "home"
    HANDOVER = "handover"
    VIEW = "view"
    NAIL = "nail"


def plan_to_place(slow: SlowStation, q: Array, place: Place, view: int = 1) -> Trajectory:
    """Plan a collision-free motion of the arm with an empty, open hand.

    The postures of views and strike are those of a nominal hammer, which must also be clear of everything.

    Args:
        slow: The station under its caps.
        q: Present joint positions, (6,) [rad].
        place: Where to go.
        view: Number of the view, from 1.

    Returns:
        The trajectory, from rest to rest, slow enough for a person in reach.

    Raises:
        UserError: There is no such view.
        PlanningError: The place is out of reach, or no way there is clear.
    """
    robot, config, world = slow.robot, slow.config, slow.world
    q_hand = robot.description.hand_open
    if place is Place.HANDOVER:
        move = plan_handover(robot, config, world, q, q_hand)
    else:
        goal = np.asarray(config.scene.home) if place is Place.HOME else _posture(slow, place, view)
        move = plan_transfer(robot, config, world, q, goal)
    return slowed_to(move, world, config.supervisor.handover_speed)


def _posture(slow: SlowStation, place: Place, view: int) -> Array:
    # Of a job, so with the station's own limits: under the caps no strike would be worth a plan.
    robot, config = slow.robot, slow.station
    if place is Place.VIEW and not 1 <= view <= config.task.views:
        raise UserError(f"view {view}: give 1 to {config.task.views}, the number of views of the station (task.views)")
    q_hand, home = robot.description.hand_closed, np.asarray(config.scene.home)
    grasp = nominal_grasp(make_tool(NAIL_DRIVERS[0], 0), config)
    X_hand_ee = grasp.X_hand_ee
    with_tool = CollisionWorld(robot, config, q_hand, X_hand_ee)
    if place is Place.NAIL:
        X_base_nail = config.work.X_base_nail()
        state = home, q_hand, X_hand_ee, X_base_nail
        return plan_strike(robot, config, with_tool, *state, tool=grasp.swung).q_standoff
    count = config.task.views
    return plan_views(robot, config, with_tool, home, q_hand, X_hand_ee, count=count).views[view - 1].q
