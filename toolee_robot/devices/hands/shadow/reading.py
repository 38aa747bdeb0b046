"""A reading of the whole hand, motor by motor and finger by finger, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from toolee_robot.devices.hands.shadow.line import Told
from toolee_robot.devices.hands.shadow.motors import described, error_of
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.robots.hands.shadow import CLOSED, MAKER_SIGNS, MOTORS, OPEN, motors_of_joints

SHOWN_TIME = 0.3
"""Time in which the controllers' states show a command [s]; they come at 50 Hz."""
MOTORS_TIME = 2.0
"""Longest time without a word of the motors' states, which come at 2 Hz [s]."""
COMMANDS_LOST = "its controllers do not do what it is told"
MOTORS_UNKNOWN = "it says nothing of its motors"
"""Faults, for people."""
PREFIXES = {"index": "FF", "middle": "MF", "ring": "RF", "little": "LF", "thumb": "TH"}
"""Finger -> beginning of the names of its motors."""
FLEXORS = [
    *([MOTORS.index(f"{finger}J3"), MOTORS.index(f"{finger}J0")] for finger in ("FF", "MF", "RF", "LF")),
    [MOTORS.index(joint) for joint in ("THJ5", "THJ2", "THJ1")],
]
"""Motors that close each finger, in the order of PREFIXES."""
AT_OPEN, AT_CLOSED = np.array(OPEN), np.array(CLOSED)
WAYS = np.array([(AT_CLOSED - AT_OPEN)[motors].sum() for motors in FLEXORS])
"""Way of each finger from open to closed, (5,) [deg]."""
_JOINTS = [np.flatnonzero(moved) for moved in np.array([motors_of_joints(q) for q in np.eye(len(MAKER_SIGNS))]).T]
"""Joints of each motor."""


@dataclass(frozen=True)
class FingersReading:
    """A reading by fingers: index, middle, ring, little, thumb."""

    stamp: float
    """Time at which it was taken [s]."""
    number: int
    """Number of the reading, from 1."""
    closures: Array
    """How far each finger is closed, (5,) [deg]: the sum of its motors' ways."""
    forces: Array
    """Effort of each finger's strongest motor, by that of a touch, (5,)."""
    fault: DeviceError | None
    """The gravest fault; None without one."""


@dataclass(frozen=True)
class Reading:
    """What the hand said.

    Attributes:
        stamp: Time at which it was taken, by the station's clock [s].
        number: Number of the reading, from 1.
        told: The messages.
        closures: Where each motor is, in the order of `MOTORS`, (20,) [deg]; more is further closed.
        forces: Effort of each motor, without its sign, (20,) [in the hand's unit].
        fault: The gravest fault; None without one.
    """

    stamp: float
    number: int
    told: Told
    closures: Array
    forces: Array
    fault: DeviceError | None

    @classmethod
    def of(cls, told: Told, number: int) -> Self:
        """Read what the hand said.

        Args:
            told: The messages.
            number: Number of the reading, from 1.

        Returns:
            The reading.
        """
        closures = motors_of_joints(MAKER_SIGNS * told.joints.position)
        # Two coupled joints report their motor's effort each.
        forces = np.array([np.abs(told.joints.effort[joints]).max() for joints in _JOINTS])
        return cls(told.stamp, number, told, closures, forces, _error(told))

    @property
    def q(self) -> Array:
        """Positions in the order of the model's joints, (24,) [rad]."""
        return MAKER_SIGNS * self.told.joints.position

    @property
    def faults(self) -> str:
        """What is wrong, for people; empty for nothing."""
        told = self.told
        lost, unknown = COMMANDS_LOST if self.ignored else "", MOTORS_UNKNOWN if told.motors_age > MOTORS_TIME else ""
        return ", ".join(filter(None, (described(told.motors.values()), lost, unknown)))

    @property
    def ignored(self) -> bool:
        """Whether the hand does not do what it is told, for SHOWN_TIME already."""
        return _ignored(self.told)

    def fingers(self, touch: float) -> FingersReading:
        """The same by fingers.

        Args:
            touch: Effort of a touch [in the hand's unit].
        """
        closures = np.array([(self.closures - AT_OPEN)[motors].sum() for motors in FLEXORS])
        forces = np.array([self.forces[motors].max() for motors in FLEXORS]) / touch
        return FingersReading(self.stamp, self.number, closures, forces, self.fault)


def named(motors: NDArray[np.bool_]) -> str:
    """Name the fingers of motors.

    Args:
        motors: Which of `MOTORS`, (20,).

    Returns:
        Their names, for people.
    """
    fingers = {prefix: finger for finger, prefix in PREFIXES.items()}
    return ", ".join(f"{fingers[MOTORS[motor][:2]]} ({MOTORS[motor]})" for motor in np.flatnonzero(motors))


def _ignored(told: Told) -> bool:
    return told.unshown is not None and told.unshown >= SHOWN_TIME


def _error(told: Told) -> DeviceError | None:
    error = error_of(told.motors.values())
    if error is not None:
        return error
    if _ignored(told):
        message = f"the hand: {COMMANDS_LOST}; see that its trajectory controllers run and nothing else commands it"
        return DeviceError(message, code="device.hand_command")
    if told.motors_age > MOTORS_TIME:
        message = f"the hand: {MOTORS_UNKNOWN}, so that nobody would know of heat; see that /diagnostics is published"
        return DeviceError(message, code="device.hand_motor")
    return None
