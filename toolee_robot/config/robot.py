"""The arm with its limits, and the hand on its flange."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from toolee_robot.config.values import STRICT, Positive
from toolee_robot.types import ArmModel, DhCalibration


@dataclass(frozen=True)
class ArmLimits:
    """Which arm it is, and what the planner may use of it.

    UR10 data sheet: base and shoulder 120 deg/s, the others 180 deg/s. Accelerations are not public: 15 rad/s^2 for
    strikes keeps the elbow, which carries most of a strike here, under 90 % of its 150 Nm (inverse dynamics of arm,
    hand and a 0.9 kg hammer while braking; 53 % in the run-up); a common, slower choice is 8.
    """

    __pydantic_config__ = STRICT
    model: ArmModel = ArmModel.UR10
    """Model of the arm."""
    calibration: DhCalibration | None = None
    """Kinematics of this very arm, from its controller; null for the model's nominal ones, a millimetre or two off."""
    velocity: tuple[Positive, Positive, Positive, Positive, Positive, Positive] = (2.09, 2.09, 3.14, 3.14, 3.14, 3.14)
    """Largest speed of each joint, base to wrist 3 [rad/s]."""
    acceleration: Positive = 15.0
    """Largest acceleration of each joint in strikes [rad/s^2]."""
    jerk: Positive = 500.0
    """Largest jerk of each joint [rad/s^3]."""
    stop_acceleration: Positive = 15.0
    """Deceleration of each joint after a contact or a stop [rad/s^2]."""
    stop_jerk: Positive = 1500.0
    """Jerk of each joint after a contact or a stop [rad/s^3]."""
    transfer_velocity_scale: Annotated[float, Field(gt=0, le=1)] = 0.35
    """Share of `velocity` that motions through free space use."""
    transfer_acceleration: Positive = 3.0
    """Largest acceleration of each joint in motions through free space [rad/s^2]."""


@dataclass(frozen=True)
class HandConfig:
    """The hand on the flange."""

    __pydantic_config__ = STRICT
    model: str = "shadow_right"
    """Name of the hand, one of `toolee_robot.robots.HANDS`."""
