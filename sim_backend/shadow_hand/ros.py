"""The ROS messages that the emulated hand publishes, written out from their definitions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from toolee_robot.sim_backend.shadow_hand.controller import Controller
from toolee_robot.sim_backend.shadow_hand.hand import Hand
from toolee_robot.sim_backend.shadow_hand.motor import Motor

JOINT_STATES, DIAGNOSTICS = "/joint_states", "/diagnostics"
TYPES = {
    JOINT_STATES: "sensor_msgs/JointState",
    DIAGNOSTICS: "diagnostic_msgs/DiagnosticArray",
    "/rh_trajectory_controller/state": "control_msgs/JointTrajectoryControllerState",
    "/rh_wr_trajectory_controller/state": "control_msgs/JointTrajectoryControllerState",
    "/rh_trajectory_controller/command": "trajectory_msgs/JointTrajectory",
    "/rh_wr_trajectory_controller/command": "trajectory_msgs/JointTrajectory",
}
"""Topic -> its type."""
PERIODS = {
    JOINT_STATES: 1 / 125, "/rh_trajectory_controller/state": 1 / 50, "/rh_wr_trajectory_controller/state": 1 / 50,
    DIAGNOSTICS: 1 / 2,
}  # fmt: skip
"""Topic that the hand publishes -> time between two messages [s]: published."""
EPOCH = 1528812878.0
"""Time of the hand's computer when it began [s]: that of the maker's example."""


def message(hand: Hand, topic: str, sequence: int) -> dict[str, Any]:
    """Build the message of a topic, as the hand is at its time.

    Args:
        hand: The hand.
        topic: The topic, one of PERIODS.
        sequence: Number of the message.

    Returns:
        The message.
    """
    header = {"seq": sequence, "stamp": _time(EPOCH + hand.now), "frame_id": ""}
    if topic == JOINT_STATES:
        names, positions, velocities, efforts = zip(*hand.joints(), strict=True)
        return {"header": header, "name": names, "position": positions, "velocity": velocities, "effort": efforts}
    if topic == DIAGNOSTICS:
        others = [{"level": 0, "name": "rh EtherCAT Dual CAN Palm", "message": "OK", "hardware_id": "", "values": []}]
        return {"header": header, "status": others + [_status(i, motor) for i, motor in enumerate(hand.motors)]}
    controller = hand.fingers if hand.fingers.name in topic else hand.wrist
    return _state(header, controller, hand)


def _state(header: dict[str, Any], controller: Controller, hand: Hand) -> dict[str, Any]:
    desired = controller.desired(hand.now)
    at = {name: (position, velocity) for name, position, velocity, _ in hand.joints()}
    actual = [at[joint][0] for joint in controller.joints]
    velocities = [at[joint][1] for joint in controller.joints]
    zeros = [0.0] * len(controller.joints)
    errors = [a - b for a, b in zip(desired, actual, strict=True)]
    return {
        "header": header,
        "joint_names": controller.joints,
        "desired": _point(desired, zeros, zeros),
        "actual": _point(actual, velocities, []),
        "error": _point(errors, [-velocity for velocity in velocities], []),
    }


def _point(positions: Sequence[float], velocities: Sequence[float], accelerations: Sequence[float]) -> dict[str, Any]:
    return {
        "positions": positions, "velocities": velocities, "accelerations": accelerations, "effort": [],
        "time_from_start": {"secs": 0, "nsecs": 0},
    }  # fmt: skip


def _status(number: int, motor: Motor) -> dict[str, Any]:
    """A motor's status, as `add_diagnostics` in `sr_motor_robot_lib.cpp` writes it; level and names are its own."""
    flags = []
    if motor.bridge_fault:
        flags.append("A3950 H-bridge nFault asserted")
    if motor.halted and motor.temperature > 55.0:
        flags.append("Motor over temperature")
    said = "".join(f"{flag} | " for flag in flags)
    values = {
        "Motor ID": f"{number}",
        "Motor ID in message": f"{number // 2}",
        "Strain Gauge Left": "0",
        "Strain Gauge Right": "0",
        "Motor Flags": said or " None",
        "Measured PWM": "0",
        "Measured Current": f"{abs(motor.effort) * 0.0004:f}",
        "Measured Voltage": f"{23.9:f}",
        "Measured Effort": f"{motor.effort:f}",
        "Temperature": f"{motor.temperature:f}",
    }
    return {
        "level": 2 if flags else 0,
        "name": f"rh SRDMotor {motor.name}",
        "message": said or "OK",
        "hardware_id": "",
        "values": [{"key": key, "value": value} for key, value in values.items()],
    }


def _time(seconds: float) -> dict[str, int]:
    secs, nsecs = divmod(round(seconds * 1e9), 10**9)
    return {"secs": secs, "nsecs": nsecs}
