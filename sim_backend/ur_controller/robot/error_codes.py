"""Codes of the controller's errors, as its log and the primary interface name them.

Codes and arguments: Universal Robots, "Error codes directory".
"""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.arm_data import JOINTS

POSITION_DEVIATES, POSITION_DEVIATES_NO_PAYLOAD = 153, 159
COLLISION, COLLISION_NO_PAYLOAD = 157, 158
HIGH_TORQUE, TORQUE_JUMP = 173, 174
SAFETY_VIOLATION, PATH_SANITY = 191, 204
JOINT_POSITION, JOINT_SPEED, TCP_SPEED, POWER, TORQUE_WINDOW, MOMENTUM = 1, 2, 3, 6, 7, 12
"""Arguments of SAFETY_VIOLATION. The force limit acts through the joints' torque windows."""
SUDDEN_STOP = 3
"""Argument of PATH_SANITY."""

_TEXTS = {
    POSITION_DEVIATES: "Position deviates from path",
    POSITION_DEVIATES_NO_PAYLOAD: "Position deviates from path, payload is 0 kg",
    COLLISION: "Collision detected by joint",
    COLLISION_NO_PAYLOAD: "Collision detected by joint, payload is 0 kg",
    HIGH_TORQUE: "Robot motion causes too high joint torques",
    TORQUE_JUMP: "Robot motion causes too high jump in joint torques",
}
_VIOLATIONS = {
    JOINT_POSITION: "Joint position limit violated",
    JOINT_SPEED: "Joint speed limit violated",
    TCP_SPEED: "TCP speed limit violated",
    POWER: "Power limit violated",
    TORQUE_WINDOW: "Joint torque window violated",
    MOMENTUM: "Momentum limit violation",
}


@dataclass(frozen=True)
class ErrorCode:
    """An error.

    Attributes:
        code: Its number.
        argument: Its argument: the joint, or the kind.
        detail: What was measured.
    """

    code: int
    argument: int
    detail: str

    @property
    def name(self) -> str:
        """The code as the log shows it, such as C153A2."""
        return f"C{self.code}A{self.argument}"

    def __str__(self) -> str:
        if self.code == SAFETY_VIOLATION:
            text = f"Safety system violation: {_VIOLATIONS[self.argument]}"
        elif self.code == PATH_SANITY:
            text = "Path sanity check failed: Sudden stop"
        else:
            text = f"{_TEXTS[self.code]}: {JOINTS[self.argument].capitalize()}"
        return f"{self.name}: {text} ({self.detail})"
