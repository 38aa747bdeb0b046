"""Limits of a swing beyond those of the station, and the tool that is swung."""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.control.dynamics.torque_room import TORQUE_SHARE
from toolee_robot.errors import UserError
from toolee_robot.types import Payload


@dataclass(frozen=True)
class SwingLimits:
    """Limits of a swing in addition to `StationConfig.arm` and `supervisor.unattended_speed`.

    Attributes:
        tool: Mass of the tool [kg] and its centre of mass in the end effector's frame [m].
        deepest: Largest distance of the commanded face beyond the contact along the nail's axis [m]; infinite for no
            bound. An arm lags behind its command and would follow it into the wood.
        torque_share: Share of the joints' rated torques that the inverse dynamics may take.
        height_error: Error of the nail's height within which the face is still square to 1 deg [m].

    Raises:
        UserError: A value is out of its range; code `user.swing_limits`.
    """

    tool: Payload
    deepest: float = 0.010
    torque_share: float = TORQUE_SHARE
    height_error: float = 0.003

    def __post_init__(self) -> None:
        if not (self.deepest >= 0.001 and 0 < self.torque_share <= 1 and 0 < self.height_error <= 0.05):
            raise UserError(
                f"swing limits {self.deepest}, {self.torque_share}, {self.height_error}: give at least 1 mm beyond the "
                "contact, a share of the torques up to 1, and a height error of up to 50 mm",
                code="user.swing_limits",
            )
