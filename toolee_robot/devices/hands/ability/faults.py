"""What the hand's one bit for each motor means: a collision, which is how it grips, or heat."""

from __future__ import annotations

from toolee_robot.devices.hands.ability.replies import Limited
from toolee_robot.errors import DeviceError

HEAT_TIME = 0.05
"""Time for which the hand must be limited by heat until it counts as hot [s]."""
HEAT = "too hot"
"""The fault, for people."""
LAPSE = "the hand was without a command for too long and may have moved"
"""The fault of a driver that could not run in time, for people."""
NO_PADS = (
    "the hand says nothing of its touch pads: it has none, or they are broken, and could not tell what it holds; use "
    "one with pads, or a mount"
)
"""Why a hand without touch pads is refused."""


class Heat:
    """Tells the heat of the palm from collisions, for which the hand has one and the same bit.

    A palm that is too hot limits every motor (ICD 3.2.3), and no collision ever limits the rotator (ICD 3.2.1): so the
    rotator's bit is heat. One finger that is too hot cannot be told from one that has collided, which is how the hand
    grips; it keeps its grip, and is found when it is told to open or to close and does not.
    """

    def __init__(self) -> None:
        self._since: float | None = None

    def judge(self, stamp: float, limited: Limited) -> bool:
        """Take a reading.

        Args:
            stamp: Its time [s].
            limited: Motors that protect themselves.

        Returns:
            Whether the hand is too hot, for HEAT_TIME already.
        """
        if Limited.THUMB_ROTATOR not in limited:
            self._since = None
            return False
        self._since = stamp if self._since is None else self._since
        return stamp - self._since >= HEAT_TIME


def heat_error() -> DeviceError:
    """Build the error of a hand that is too hot."""
    message = "the hand protects its motors from heat: let it cool down; it keeps its grip"
    return DeviceError(message, code="device.hand_over_temperature")
