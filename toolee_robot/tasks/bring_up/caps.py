"""The caps of a bring-up: a station's limits, lowered. The supervisor and the driver refuse whatever exceeds them.

    slow = SlowStation.of(load_station(Path("lab.yaml")), Caps())
    with open_arm(slow.config, host, person) as arm:
        arm.execute(plan_joints(slow, arm.state().q_commanded, q_goal))

Both get the station under its caps, so neither knows any other limit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from toolee_robot.control import CollisionWorld, RobotModel
from toolee_robot.errors import UserError
from toolee_robot.station import StationConfig

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
        acceleration: Largest acceleration of every joint [rad/s^2]; a stop may take more where the speed was raised
            and the acceleration was not, so that it still ends within RAMP.

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
                raise UserError(f"the cap of the {name} is {value}: give a number from {least:g} on", code="user.cap")

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
        acceleration = min(arm.acceleration, arm.transfer_acceleration, self.acceleration)
        stop = min(arm.stop_acceleration, max(self.acceleration, self.speed / RAMP))
        a, b, c, d, e, f = velocity.tolist()
        limits = replace(
            arm,
            velocity=(a, b, c, d, e, f),
            acceleration=acceleration,
            jerk=min(arm.jerk, acceleration / RAMP),
            stop_acceleration=stop,
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
