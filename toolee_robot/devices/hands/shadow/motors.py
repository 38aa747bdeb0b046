"""What the hand says of its motors, twice a second: heat, current, and what their firmware found."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum, StrEnum

from toolee_robot.errors import DeviceError

HALTS_AT = 60.0
"""Temperature at which the firmware halts a motor [deg C] (user guide, *Firmware*, Safety)."""
HOT = "too hot"
"""The fault, for people."""


class Level(IntEnum):
    """Level of a diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Flag(StrEnum):
    """Flags with which the firmware halts a motor (`0220_palm_edc_ethercat_protocol.h`), as they are published."""

    NO_DEMAND = "No demand seen for more than 20ms"
    DRIVER_FAULT = "A3950 H-bridge nFault asserted"
    BAD_CONFIGURATION = "EEPROM contains bad CRC. Motor off."
    OVER_TEMPERATURE = "Motor over temperature"


CHOKED = "Current choke bit"
"""Beginning of the flags of a motor whose current the firmware limits; it goes on working."""


@dataclass(frozen=True)
class MotorStatus:
    """State of one motor."""

    motor: str
    """The maker's name of its joint, such as "FFJ0"."""
    level: Level
    """How grave it is."""
    summary: str
    """What the hand says of it, for people."""
    flags: frozenset[Flag] = frozenset()
    """Why it is halted; empty for one that works."""
    choked: bool = False
    """Whether the firmware limits its current."""
    temperature: float | None = None
    """Temperature near the motor [deg C]; None if the hand does not tell."""
    current: float | None = None
    """Motor current [A]; None if the hand does not tell."""

    @property
    def hot(self) -> bool:
        """Whether its firmware halts it because of heat."""
        return Flag.OVER_TEMPERATURE in self.flags or (self.temperature or 0.0) > HALTS_AT

    @property
    def fault(self) -> str:
        """What is wrong with it, for people; empty for nothing."""
        if self.hot:
            return f"{self.motor}: {HOT}"
        return f"{self.motor}: {self.summary}" if self.level >= Level.ERROR else ""


def described(motors: Iterable[MotorStatus]) -> str:
    """Describe what is wrong with the motors.

    Args:
        motors: The motors.

    Returns:
        In words; empty for nothing.
    """
    return ", ".join(motor.fault for motor in motors if motor.fault)


def error_of(motors: Iterable[MotorStatus]) -> DeviceError | None:
    """Build the error for what is wrong with the motors.

    Args:
        motors: The motors.

    Returns:
        The error with the code of the gravest fault; None without one.
    """
    faulty = [motor for motor in motors if motor.fault]
    if not faulty:
        return None
    if all(motor.hot for motor in faulty):
        code, remedy = "device.hand_over_temperature", "let it cool down"
    else:
        code, remedy = "device.hand_motor", "look at it in the maker's own interface"
    message = f"the hand reports a fault ({described(faulty)}): {remedy}; a motor that is halted does not press"
    return DeviceError(message, code=code)
