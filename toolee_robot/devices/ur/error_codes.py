"""Plain meaning of the controller's error codes that hammering can bring about, and what to do about each.

`C173A2` is code 173 with argument 2. Codes and arguments: Universal Robots, "Error codes directory"; any other code is
named without a meaning.
"""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.devices.ur.protocols.primary import ControllerError

JOINTS = ("the base", "the shoulder", "the elbow", "wrist 1", "wrist 2", "wrist 3")

_HIT = "it was hit, or the motion was too fast for the payload that is set"
_NO_PAYLOAD = "no payload is set: set it"
_LIMIT = "slow the motion down, or see the robot's safety configuration"


@dataclass(frozen=True)
class _Meaning:
    """Meaning of a code.

    Attributes:
        kind: Last part of the code of the driver's error.
        text: What has happened; `{joint}` stands for the argument's joint.
        remedy: What to look at, or to change.
    """

    kind: str
    text: str
    remedy: str


_CODES = {
    153: _Meaning("position_deviation", "{joint} was off its path", _HIT),
    159: _Meaning("position_deviation", "{joint} was off its path", _NO_PAYLOAD),
    157: _Meaning("collision", "{joint} detected a collision", _HIT),
    158: _Meaning("collision", "{joint} detected a collision", _NO_PAYLOAD),
    173: _Meaning(
        "torque",
        "the motion takes more torque than {joint} has",
        "slow it down, move the work nearer to the arm, or check the payload that is set",
    ),
    174: _Meaning(
        "torque_jump",
        "the motion changes the torque of {joint} too suddenly",
        "lower acceleration and jerk, or check the payload that is set",
    ),
}
_WITH_ARGUMENT = {
    (191, 1): _Meaning("safety_limit", "a joint passed its position limit", "see the robot's safety configuration"),
    (191, 2): _Meaning("safety_limit", "a joint passed its speed limit", _LIMIT),
    (191, 3): _Meaning("safety_limit", "the TCP passed its speed limit", _LIMIT),
    (191, 6): _Meaning("safety_limit", "the arm passed its power limit", _LIMIT),
    (191, 7): _Meaning("safety_limit", "a force or torque passed its limit", "see what the arm has touched"),
    (191, 12): _Meaning("safety_limit", "the arm passed its momentum limit", _LIMIT),
    (204, 1): _Meaning("path", "a commanded position jumped", "see why, in the log of the motion"),
    (204, 3): _Meaning("path", "the commands ended while the arm moved", "see whether this computer was too slow"),
}


def explain(error: ControllerError) -> tuple[str, str]:
    """Explain an error of the controller.

    Args:
        error: The error.

    Returns:
        A clause for a message, which names the code; and the kind of the error, empty where the code is not known here.
    """
    meaning = _WITH_ARGUMENT.get((error.code, error.argument), _CODES.get(error.code))
    if meaning is None:
        said = f', "{error.text}"' if error.text else ""
        return f"{error.name}{said} (see the robot's log, and Universal Robots' directory of error codes)", ""
    joint = JOINTS[error.argument] if 0 <= error.argument < len(JOINTS) else "the arm"
    return f"{error.name}: {meaning.text.format(joint=joint)}; {meaning.remedy}", meaning.kind
