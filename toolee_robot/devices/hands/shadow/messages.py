"""The ROS messages in use: joint states, the controllers' states, diagnostics; and the command.

Fields are those of sensor_msgs/JointState, control_msgs/JointTrajectoryControllerState, diagnostic_msgs/DiagnosticArray
and trajectory_msgs/JointTrajectory of ROS 1, as rosbridge writes them: a time is {"secs": ..., "nsecs": ...}, a number
that is not finite is null.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from toolee_robot.devices.hands.shadow.motors import CHOKED, Flag, Level, MotorStatus
from toolee_robot.errors import ProtocolError
from toolee_robot.frames import Array
from toolee_robot.robots.hands.shadow import MOTORS

PREFIX = "rh_"
"""Prefix of the right hand's joints."""
JOINT_STATES, JOINT_STATE = "/joint_states", "sensor_msgs/JointState"
FINGERS, WRIST = "/rh_trajectory_controller", "/rh_wr_trajectory_controller"
STATE, COMMAND = "control_msgs/JointTrajectoryControllerState", "trajectory_msgs/JointTrajectory"
DIAGNOSTICS, DIAGNOSTIC = "/diagnostics", "diagnostic_msgs/DiagnosticArray"
MOTOR = "rh SRDMotor "
"""Beginning of the names of the motors' statuses (`sr_motor_robot_lib.cpp`)."""
NOT_OURS = "protocol.hand_values"
BEYOND = math.radians(20.0)
"""Angle by which a joint may be beyond its range; a sensor is not calibrated better than that, and fingers give way."""
FASTEST, STRONGEST, HOTTEST, MOST_CURRENT = 100.0, 32768.0, 150.0, 70.0
"""Velocities [rad/s], efforts, temperatures [deg C] and currents [A] above which none are: the last three are those of
the firmware's 16-bit numbers, but for the temperature's."""
_RANGES = {
    "J1": (0, 90), "J2": (0, 90), "J3": (-15, 90), "J4": (-20, 20), "LFJ5": (0, 45), "THJ1": (-15, 90),
    "THJ2": (-40, 40), "THJ3": (-12, 12), "THJ4": (0, 70), "THJ5": (-60, 60), "WRJ1": (-40, 28), "WRJ2": (-30, 10),
}  # fmt: skip
"""Ranges of the joints [deg] (user guide, *Ranges*)."""


@dataclass(frozen=True)
class JointStates:
    """A sensor_msgs/JointState of the whole hand; arrays are in the order in which the joints were asked for."""

    stamp: float
    """Time at the hand's computer [s]."""
    position: Array
    """Positions as the maker counts them, (n,) [rad]."""
    velocity: Array
    """Velocities, (n,) [rad/s]."""
    effort: Array
    """Efforts, (n,) [the difference of the motor's strain gauges, in counts]."""


@dataclass(frozen=True)
class ControllerState:
    """Where a controller wants its joints to be."""

    stamp: float
    """Time at the hand's computer [s]."""
    desired: Array
    """Positions, in the order in which the joints were asked for, (n,) [rad]."""


def limits_of(joint: str) -> tuple[float, float]:
    """Range of a joint.

    Args:
        joint: Its name, such as `rh_FFJ1`.

    Returns:
        Its ends as the maker counts them [rad].
    """
    name = joint.removeprefix(PREFIX)
    low, high = _RANGES.get(name) or _RANGES[name[2:]]
    return math.radians(low), math.radians(high)


def joint_states(message: Mapping[str, Any], joints: Sequence[str]) -> JointStates | None:
    """Read a sensor_msgs/JointState.

    Args:
        message: The message.
        joints: Names of the hand's joints.

    Returns:
        The joints' states; None for a message that says nothing of this hand: other robots publish on the topic, too.

    Raises:
        ProtocolError: It lacks some of the hand's joints, or says what no Shadow Hand says.
    """
    names = _names(message.get("name"))
    index = {name: i for i, name in enumerate(names)}
    if index.keys().isdisjoint(joints):
        return None
    order = _order(index, len(names), joints)
    position = _numbers(message, "position", len(names))[order]
    velocity = _numbers(message, "velocity", len(names))[order]
    effort = _numbers(message, "effort", len(names))[order]
    _within(position, joints)
    if np.abs(velocity).max() > FASTEST or np.abs(effort).max() > STRONGEST:
        raise ProtocolError("the hand reports velocities or efforts that no hand has", code=NOT_OURS)
    return JointStates(_stamp(message), position, velocity, effort)


def controller_state(message: Mapping[str, Any], joints: Sequence[str]) -> ControllerState:
    """Read a control_msgs/JointTrajectoryControllerState.

    Args:
        message: The message.
        joints: Names of the controller's joints.

    Returns:
        Where the controller wants them to be.

    Raises:
        ProtocolError: It is of other joints, or says what no Shadow Hand says.
    """
    names = _names(message.get("joint_names"))
    order = _order({name: i for i, name in enumerate(names)}, len(names), joints)
    desired = message.get("desired")
    if not isinstance(desired, dict) or len(names) != len(joints):
        raise ProtocolError("a controller reports no desired state of its joints", code=NOT_OURS)
    positions = _numbers(desired, "positions", len(names))[order]
    _within(positions, joints)
    return ControllerState(_stamp(message), positions)


def motor_statuses(message: Mapping[str, Any]) -> dict[str, MotorStatus]:
    """Read a diagnostic_msgs/DiagnosticArray.

    Args:
        message: The message.

    Returns:
        The motors that it speaks of, by the names of `MOTORS`; none in one that is of other devices.

    Raises:
        ProtocolError: It says what no Shadow Hand says.
    """
    _stamp(message)
    found = {}
    for status in _list(message.get("status")):
        if not isinstance(status, dict) or not isinstance(status.get("name"), str):
            raise ProtocolError("a diagnostic status has no name", code=NOT_OURS)
        name = status["name"].removeprefix(MOTOR)
        if name != status["name"] and name in MOTORS:
            found[name] = _motor(name, status)
    return found


def trajectory(joints: Sequence[str], positions: Array, duration: float) -> dict[str, Any]:
    """Build a trajectory_msgs/JointTrajectory with one point, which begins at once.

    Args:
        joints: Names of the controller's joints, all of them: it takes no part (`allow_partial_joints_goal`).
        positions: Where they shall be, (n,) [rad].
        duration: Time until then [s]; a point in the past is dropped.

    Returns:
        The message. Without velocities the controller goes there on a straight line.
    """
    secs, nsecs = divmod(round(duration * 1e9), 10**9)
    return {
        "header": {"stamp": {"secs": 0, "nsecs": 0}, "frame_id": ""},
        "joint_names": list(joints),
        "points": [
            {
                "positions": [round(float(angle), 6) for angle in positions],
                "velocities": [],
                "accelerations": [],
                "effort": [],
                "time_from_start": {"secs": secs, "nsecs": nsecs},
            }
        ],
    }


def _stamp(message: Mapping[str, Any]) -> float:
    header = message.get("header")
    stamp = header.get("stamp") if isinstance(header, dict) else None
    secs, nsecs = (stamp.get("secs"), stamp.get("nsecs")) if isinstance(stamp, dict) else (None, None)
    if type(secs) is not int or type(nsecs) is not int or not 0 <= secs < 2**32 or not 0 <= nsecs < 10**9:
        raise ProtocolError("a message has no time stamp of ROS 1", code=NOT_OURS)
    return secs + 1e-9 * nsecs


def _names(value: object) -> list[str]:
    names = [name for name in _list(value) if isinstance(name, str)]
    if len(names) != len(_list(value)) or len(set(names)) != len(names):
        raise ProtocolError("a message names its joints in no way that can be understood", code=NOT_OURS)
    return names


def _list(value: object) -> list[Any]:
    if not isinstance(value, list):
        raise ProtocolError("a message lacks a list", code=NOT_OURS)
    return value


def _order(index: Mapping[str, int], count: int, joints: Sequence[str]) -> list[int]:
    lacking = [joint for joint in joints if joint not in index]
    if lacking or count < len(joints):
        raise ProtocolError(f"a message of the hand lacks {', '.join(lacking)}", code=NOT_OURS)
    return [index[joint] for joint in joints]


def _numbers(message: Mapping[str, Any], field: str, count: int) -> Array:
    values = message.get(field)
    if not isinstance(values, list) or len(values) != count or not {type(value) for value in values} <= {int, float}:
        raise ProtocolError(f"{field} is no list of {count} numbers", code=NOT_OURS)
    try:
        numbers = np.array(values, float)
    except OverflowError as error:
        raise ProtocolError(f"{field} has a number that is too large", code=NOT_OURS) from error
    if not np.isfinite(numbers).all():
        raise ProtocolError(f"{field} has a number that is too large", code=NOT_OURS)
    return numbers


def _within(positions: Array, joints: Sequence[str]) -> None:
    for angle, joint in zip(positions, joints, strict=True):
        low, high = limits_of(joint)
        if not low - BEYOND <= angle <= high + BEYOND:
            raise ProtocolError(f"{joint} is said to be at {np.rad2deg(angle):.0f} deg", code=NOT_OURS)


def _motor(name: str, status: Mapping[str, Any]) -> MotorStatus:
    level, summary = status.get("level"), status.get("message")
    if type(level) is not int or not 0 <= level <= 3 or not isinstance(summary, str):
        raise ProtocolError(f"the status of {name} has no level", code=NOT_OURS)
    values: dict[str, str] = {}
    for pair in _list(status.get("values")):
        if not isinstance(pair, dict) or not isinstance(pair.get("key"), str) or not isinstance(pair.get("value"), str):
            raise ProtocolError(f"the status of {name} has a value without a name", code=NOT_OURS)
        values[pair["key"]] = pair["value"]
    said = values.get("Motor Flags", "")
    return MotorStatus(
        name,
        Level(level),
        summary,
        frozenset(flag for flag in Flag if flag in said),
        CHOKED in said,
        _value(values, "Temperature", HOTTEST),
        _value(values, "Measured Current", MOST_CURRENT),
    )


def _value(values: Mapping[str, str], key: str, most: float) -> float | None:
    if key not in values:
        return None
    try:
        value = float(values[key])
    except ValueError as error:
        raise ProtocolError(f"{key} is said to be {values[key]!r}", code=NOT_OURS) from error
    if not 0.0 <= value <= most:
        raise ProtocolError(f"{key} is said to be {value}", code=NOT_OURS)
    return value
