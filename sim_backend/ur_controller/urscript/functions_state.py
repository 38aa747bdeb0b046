"""URScript functions that read the arm's state or change its settings, as in the Script Manual."""

from __future__ import annotations

from typing import Any

import numpy as np

from toolee_robot import frames
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.robot.kinematics import forward, inverse
from toolee_robot.sim_backend.ur_controller.robot.machine import Machine
from toolee_robot.sim_backend.ur_controller.robot.motion import MotionError
from toolee_robot.sim_backend.ur_controller.urscript.functions_library import Pose, as_pose, matrix, numbers, six

CONTACT = 20.0  # [N] against the direction above which there is contact
CONTACT_START = 5.0  # [N] above which a contact has begun


class StateFunctions:
    """Functions for state and settings.

    Args:
        machine: The robot.
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine

    # -- joints and TCP

    def get_actual_joint_positions(self) -> list[float]:
        return _list(self._machine.sensors.q)

    def get_actual_joint_speeds(self) -> list[float]:
        return _list(self._machine.sensors.qd)

    def get_target_joint_positions(self) -> list[float]:
        return _list(self._machine.q_target)

    def get_target_joint_speeds(self) -> list[float]:
        return _list(self._machine.qd_target)

    def get_actual_joint_positions_history(self, steps: int = 0) -> list[float]:
        """Joint positions a number of ticks ago."""
        history = self._machine.history
        if type(steps) is not int or not 0 <= steps < len(history):
            raise ValueError(f"there is no history of {steps} steps")
        return _list(history[-1 - steps])

    def get_actual_tcp_pose(self) -> Pose:
        return as_pose(self._machine.tcp_pose())

    def get_target_tcp_pose(self) -> Pose:
        return as_pose(self._machine.tcp_pose(target=True))

    def get_actual_tool_flange_pose(self) -> Pose:
        return as_pose(forward(self._machine.model, self._machine.sensors.q))

    def get_actual_tcp_speed(self) -> list[float]:
        return _list(self._machine.tcp_speed())

    def get_target_tcp_speed(self) -> list[float]:
        return _list(self._machine.tcp_speed(target=True))

    def get_target_waypoint(self) -> Pose:
        """Pose of the TCP at the end of the current move."""
        goal = self._machine.goal()
        return as_pose(forward(self._machine.model, goal) @ self._machine.X_flange_tcp)

    def is_steady(self) -> bool:
        return not self._machine.moving

    # -- kinematics

    def get_forward_kin(self, q: Any = "current_joint_positions", tcp: Any = "active_tcp") -> Pose:
        joints = self._machine.sensors.q if isinstance(q, str) else six(q, "joint vector")
        return as_pose(forward(self._machine.model, joints) @ self._offset(tcp))

    def get_inverse_kin(
        self,
        x: Any,
        qnear: Any = "current_joint_positions",
        maxPositionError: float = 1e-10,
        maxOrientationError: float = 1e-10,
        tcp: Any = "active_tcp",
    ) -> list[float]:
        """Inverse kinematics; ends the program if x is out of reach.

        The tolerances are not used, as the solution is exact.
        """
        numbers(maxPositionError, maxOrientationError)
        q = self._inverse(x, qnear, tcp)
        if q is None:
            raise MotionError(f"get_inverse_kin: no joints reach the pose {np.round(six(x), 4).tolist()}")
        return q

    def get_inverse_kin_has_solution(
        self,
        pose: Any,
        qnear: Any = "current_joint_positions",
        maxPositionError: float = 1e-10,
        maxOrientationError: float = 1e-10,
        tcp: Any = "active_tcp",
    ) -> bool:
        numbers(maxPositionError, maxOrientationError)
        return self._inverse(pose, qnear, tcp) is not None

    def _inverse(self, x: Any, qnear: Any, tcp: Any) -> list[float] | None:
        near = self._machine.q_target if isinstance(qnear, str) else six(qnear, "joint vector")
        return inverse(self._machine.model, matrix(x) @ frames.inverse(self._offset(tcp)), near)

    def _offset(self, tcp: Any) -> Array:
        return self._machine.X_flange_tcp if isinstance(tcp, str) else matrix(tcp)

    def is_within_safety_limits(self, pose: Any) -> bool:
        """Whether a pose or joint positions are within the joint limits."""
        if isinstance(pose, Pose):
            return self._inverse(pose, "", "") is not None
        return bool(np.all(np.abs(six(pose, "joint vector")) <= np.array(self._machine.model.position)))

    # -- forces

    def get_tcp_force(self) -> list[float]:
        return _list(self._machine.tcp_force())

    def force(self) -> float:
        return float(np.linalg.norm(self._machine.tcp_force()[:3]))

    def get_joint_torques(self) -> list[float]:
        return _list(self._machine.joint_torques())

    def zero_ftsensor(self) -> None:
        self._machine.zero_wrench()

    def tool_contact(self, direction: Any = None) -> int:
        """Number of ticks since just before the current contact began; 0 without contact.

        Args:
            direction: Direction in base axes against which the contact acts; None or zeros for any direction.
        """
        axis = np.array(six([0.0] * 6 if direction is None else direction, "direction")[:3])
        length = float(np.linalg.norm(axis))
        steps = 0
        for force in reversed(self._machine.force_history):
            push = float(np.linalg.norm(force)) if length < 1e-10 else -float(force @ axis) / length
            if steps == 0 and push < CONTACT:
                return 0
            if push < CONTACT_START:
                return steps
            steps += 1
        return steps

    def ft_rtde_input_enable(
        self, enable: Any, sensor_mass: float = 0, sensor_measuring_offset: Any = None, sensor_cog: Any = None
    ) -> None:
        """Use RTDE's external_force_torque, at the flange in its axes, as the wrench; the sensor's mass is ignored."""
        del sensor_measuring_offset, sensor_cog
        numbers(sensor_mass, 0)
        self._machine.force_sensor.external = enable is True

    def enable_external_ft_sensor(
        self, enable: Any, sensor_mass: float = 0, sensor_measuring_offset: Any = None, sensor_cog: Any = None
    ) -> None:
        self.ft_rtde_input_enable(enable, sensor_mass, sensor_measuring_offset, sensor_cog)

    # -- settings

    def set_tcp(self, pose: Any, tcp_name: str = "") -> None:
        del tcp_name
        self._machine.tcp = np.array(six(pose, "pose"))

    def get_tcp_offset(self) -> Pose:
        return Pose(_list(self._machine.tcp))

    def set_payload(self, m: float, cog: Any = None) -> None:
        """Set the payload; the centre of gravity [m] defaults to the flange's origin."""
        self._machine.set_payload(self._mass(m), _three([0.0] * 3 if cog is None else cog))

    def set_target_payload(self, m: float, cog: Any = None, inertia: Any = None) -> None:
        self.set_payload(m, cog)
        self._machine.payload_inertia = np.array(six([0.0] * 6 if inertia is None else inertia, "inertia"))

    def _mass(self, m: float) -> float:
        numbers(m, 0)
        if not 0 <= m <= self._machine.model.payload:
            raise ValueError(f"a payload of {m} kg: this arm carries 0 to {self._machine.model.payload} kg")
        return float(m)

    def get_target_payload(self) -> float:
        return self._machine.payload

    def get_target_payload_cog(self) -> list[float]:
        return _list(self._machine.payload_cog)

    def get_target_payload_inertia(self) -> list[float]:
        return _list(self._machine.payload_inertia)

    def set_gravity(self, d: Any) -> None:
        """Set the acceleration equivalent to gravity [m/s^2], base axes; points upwards."""
        self._machine.gravity = _three(d)


def _list(values: Array) -> list[float]:
    return values.tolist()


def _three(values: Any) -> Array:
    if not isinstance(values, list) or len(values) != 3:
        raise TypeError("expected a list of 3 numbers")
    return np.array(six([*values, 0.0, 0.0, 0.0])[:3])
