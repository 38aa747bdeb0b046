"""Messages between the task's process and the servo process: requests, and replies to them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from toolee_robot.hal import ContactGuard, MotionWatch
from toolee_robot.hardware.ur.config import UrArmConfig
from toolee_robot.hardware.ur.servo.clock import Realtime


class Cause(IntEnum):
    """Why a motion ended. From DATA on it is a fault; from PROGRAM_ENDED on nothing may be sent any more."""

    NONE = 0
    CONTACT = 1
    STOP = 2
    TASK_ENDED = 3
    DATA = 4
    TRACKING = 5
    OVERRUN = 6
    TASK_STALLED = 7
    PROGRAM_ENDED = 8
    STOPPED_BY_ROBOT = 9
    LINK = 10


@dataclass(frozen=True)
class MotionRequest:
    """What the task sends with a path. samples, knots: as `ServoMemory.write_path` returned them. stop: the value of
    the task's stop counter when it was sent. acceleration, jerk: of braking. lag [s]: the most of the servo."""

    samples: int
    knots: int
    guard: ContactGuard | None
    watch: MotionWatch
    acceleration: float
    jerk: float
    lag: float
    stop: int


@dataclass(frozen=True)
class Connect:
    """The first request. rate: the controller's [Hz]."""

    config: UrArmConfig
    rate: float


@dataclass(frozen=True)
class SetPayload:
    """mass [kg], center_of_mass [m] in the flange."""

    mass: float
    center_of_mass: list[float]


@dataclass(frozen=True)
class Freedrive:
    on: bool


class Close:
    """End the robot's program and this process."""


Request = Connect | MotionRequest | SetPayload | Freedrive | Close


@dataclass(frozen=True)
class Connected:
    realtime: Realtime


@dataclass(frozen=True)
class MotionEnded:
    cause: Cause


@dataclass(frozen=True)
class Done:
    pass


@dataclass(frozen=True)
class Refused:
    """not_ready: the robot has to be made ready first."""

    message: str
    not_ready: bool


Reply = Connected | MotionEnded | Done | Refused
