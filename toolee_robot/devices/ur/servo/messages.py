"""Messages between the task's process and the servo process: requests and their replies."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.servo.clock import Realtime
from toolee_robot.errors import DeviceError, NotReadyError
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard, MotionWatch


class Cause(IntEnum):
    """Why a motion ended, in the order of severity.

    Values from DATA on are faults, which latch; from PROGRAM_ENDED on no command may be sent.

    Attributes:
        NONE: The path was completed.
        CONTACT: The contact guard was triggered.
        STOP: `stop` was called.
        TASK_ENDED: The task's process ended, or this process was asked to terminate.
        DATA: The robot's data were late or implausible.
        SPEED_SLIDER: A person has moved the speed slider.
        SPEED_SCALING: The controller executes motions slower than they are commanded.
        TRACKING: The tracking error was too large.
        OVERRUN: Too many commands in a row were late.
        TASK_STALLED: The task's heartbeat stopped.
        PROGRAM_ENDED: The robot's control script ended, or ur_rtde refused to send.
        PROGRAM_PAUSED: The robot's control script is paused; this process ends it.
        STOPPED_BY_ROBOT: The robot's safety system stopped it, or it left its running mode.
        LINK: The connection was lost.
    """

    NONE = 0
    CONTACT = 1
    STOP = 2
    TASK_ENDED = 3
    DATA = 4
    SPEED_SLIDER = 5
    SPEED_SCALING = 6
    TRACKING = 7
    OVERRUN = 8
    TASK_STALLED = 9
    PROGRAM_ENDED = 10
    PROGRAM_PAUSED = 11
    STOPPED_BY_ROBOT = 12
    LINK = 13


@dataclass(frozen=True)
class MotionRequest:
    """Request to execute the path in the shared memory.

    Attributes:
        samples: Number of command samples, as `ServoMemory.write_path` returned it.
        knots: Number of trajectory samples, as `ServoMemory.write_path` returned it.
        guard: Contact at which to stop, or None.
        watch: Bounds to check in every cycle.
        acceleration: Deceleration of each joint in a path stop, (6,) [rad/s^2].
        jerk: Joint jerk of a path stop [rad/s^3].
        lag: Upper bound of the servo's delay [s].
        stop: Value of the task's stop counter when the request was sent; the arm stops when it changes.
    """

    samples: int
    knots: int
    guard: ContactGuard | None
    watch: MotionWatch
    acceleration: Array
    jerk: float
    lag: float
    stop: int


@dataclass(frozen=True)
class Connect:
    """Request to connect to the robot; the first one.

    Attributes:
        config: The driver's settings.
        rate: The controller's rate [Hz].
    """

    config: UrArmConfig
    rate: float


@dataclass(frozen=True)
class SetPayload:
    """Request to set the payload.

    Attributes:
        mass: Mass [kg].
        center_of_mass: x, y, z [m] in the flange frame.
    """

    mass: float
    center_of_mass: list[float]


@dataclass(frozen=True)
class Freedrive:
    """Request to enter or leave freedrive.

    Attributes:
        on: True to enter, False to leave.
    """

    on: bool


class ZeroWrench:
    """Request to zero the force reading."""


class Close:
    """Request to end the robot's program and the servo process; there is no reply."""


Request = Connect | MotionRequest | SetPayload | ZeroWrench | Freedrive | Close


@dataclass(frozen=True)
class Connected:
    """Reply to `Connect`.

    Attributes:
        realtime: Real-time privileges that the operating system granted.
    """

    realtime: Realtime


@dataclass(frozen=True)
class MotionEnded:
    """Reply to `MotionRequest`, once the arm stands.

    Attributes:
        cause: Why the motion ended.
    """

    cause: Cause


@dataclass(frozen=True)
class Done:
    """Reply to `SetPayload`, `ZeroWrench` and `Freedrive`: the robot has acknowledged the request."""


@dataclass(frozen=True)
class Refused:
    """Reply to a request that failed.

    Attributes:
        message: What happened, and what to do about it.
        not_ready: Whether a person must make the robot ready first.
        code: The error's code.
    """

    message: str
    not_ready: bool
    code: str

    @classmethod
    def from_error(cls, error: DeviceError) -> Refused:
        """The reply that reports an error of the servo process."""
        return cls(str(error), isinstance(error, NotReadyError), error.code)

    def error(self) -> DeviceError:
        """The error to raise in the task's process."""
        return (NotReadyError if self.not_ready else DeviceError)(self.message, code=self.code)


Reply = Connected | MotionEnded | Done | Refused
