"""Detection of collisions and of motions beyond the safety limits."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from toolee_robot.frames import Array, cross
from toolee_robot.sim_backend.ur_controller.profile import SafetyLimits
from toolee_robot.sim_backend.ur_controller.robot.machine import Machine
from toolee_robot.sim_backend.ur_controller.robot.safety import error_codes as codes
from toolee_robot.sim_backend.ur_controller.robot.safety.error_codes import ErrorCode


@dataclass(frozen=True)
class Measured:
    """What is measured in a tick.

    Attributes:
        q: Joint positions, (6,) [rad].
        qd: Joint velocities, (6,) [rad/s].
        twist: Velocity of the TCP, (6,) [m/s, rad/s].
        jacobian: Jacobian of the TCP, (6, 6).
        arm: From the flange's origin to the TCP, (3,) [m], base axes.
    """

    q: Array
    qd: Array
    twist: Array
    jacobian: Array
    arm: Array


class CollisionDetection:
    """Compares what is measured with what is planned, tick by tick.

    Args:
        machine: The robot.
        limits: The limits.

    Attributes:
        limits: The limits.
        deviation_ratio: Largest deviation of a joint from its set-point over its limit; 1 stops the arm.
        collision_ratio: Largest torque of the environment at a joint over its limit, likewise.
    """

    def __init__(self, machine: Machine, limits: SafetyLimits) -> None:
        self.limits = limits
        self.deviation_ratio = self.collision_ratio = 0.0
        self._machine = machine
        model = machine.model
        self._largest = np.array(model.torque)
        self._range = np.array(limits.joint_position) * np.array(model.position)
        self._fastest = limits.joint_speed * np.array(model.velocity)
        self._force = np.zeros(3)
        self._torque = np.zeros(6)
        self._power = 0.0
        self._planned: Array | None = None
        self._uncommanded = 0

    def forget(self) -> None:
        """Start again, as after a stop."""
        self._force, self._torque, self._power = np.zeros(3), np.zeros(6), 0.0
        self._planned, self._uncommanded = None, 0
        self.collision_ratio = 0.0

    def step(self, dt: float, measured: Measured) -> ErrorCode | None:
        """Check a tick.

        Args:
            dt: Length of the tick [s].
            measured: What was measured in it.

        Returns:
            The error that stops the arm, or None.
        """
        limits, machine = self.limits, self._machine
        share = min(1.0, dt / limits.force_time)
        wrench = machine.sensors.wrench
        self._force += share * (wrench[:3] - self._force)
        found = self._deviation(measured) or self._violation(measured)
        if min(limits.collision_torque, limits.power) < inf:
            at_tcp = np.concatenate([wrench[:3], wrench[3:] - cross(measured.arm, wrench[:3])])
            outside = measured.jacobian.T @ at_tcp
            self._torque += share * (outside - self._torque)
            self._power += share * (abs(float(outside @ measured.qd)) - self._power)
            found = found or self._collision()
        return found or self._motion()

    def _deviation(self, measured: Measured) -> ErrorCode | None:
        limit, machine = self.limits.following_error, self._machine
        error = np.abs(machine.q_target - measured.q)
        joint = int(error.argmax())
        self.deviation_ratio = float(error[joint]) / limit
        if self.deviation_ratio < 1.0:
            return None
        code = codes.POSITION_DEVIATES if machine.payload > 0.0 else codes.POSITION_DEVIATES_NO_PAYLOAD
        return ErrorCode(code, joint, f"joint {joint} is {error[joint]:.2f} rad from its set-point")

    def _collision(self) -> ErrorCode | None:
        machine, limits = self._machine, self.limits
        ratios = np.abs(self._torque) / (limits.collision_torque * self._largest)
        joint = int(ratios.argmax())
        self.collision_ratio = float(ratios[joint])
        if self.collision_ratio >= 1.0:
            code = codes.COLLISION if machine.payload > 0.0 else codes.COLLISION_NO_PAYLOAD
            return ErrorCode(code, joint, f"torque of {abs(self._torque[joint]):.0f} Nm from outside")
        if self._power > limits.power:
            detail = f"power of {self._power:.0f} W is over {limits.power:.0f} W"
            return ErrorCode(codes.SAFETY_VIOLATION, codes.POWER, detail)
        return None

    def _violation(self, measured: Measured) -> ErrorCode | None:
        limits, machine = self.limits, self._machine
        argument, detail = 0, ""
        force = float(np.sqrt(self._force @ self._force))
        over = np.abs(measured.qd) - self._fastest
        speed = float(np.sqrt(measured.twist[:3] @ measured.twist[:3]))
        dynamics = machine.sensors.dynamics
        carried = 0.0 if dynamics is None else float(np.sqrt(dynamics.momentum @ dynamics.momentum))
        if force > limits.force:
            argument, detail = codes.TORQUE_WINDOW, f"force of {force:.0f} N is over {limits.force:.0f} N"
        elif (beyond := np.abs(measured.q) - self._range).max() > 0.0:
            joint = int(beyond.argmax())
            argument, detail = codes.JOINT_POSITION, f"joint {joint} is at its limit"
        elif over.max() > 0.0:
            argument, detail = codes.JOINT_SPEED, f"joint {int(over.argmax())} is too fast"
        elif speed > limits.tcp_speed:
            detail = f"TCP speed of {speed:.2f} m/s is over {limits.tcp_speed:.2f} m/s"
            argument = codes.TCP_SPEED
        elif carried > limits.momentum:
            detail = f"momentum of {carried:.1f} kg m/s is over {limits.momentum:.1f} kg m/s"
            argument = codes.MOMENTUM
        return ErrorCode(codes.SAFETY_VIOLATION, argument, detail) if detail else None

    def _motion(self) -> ErrorCode | None:
        """Errors of the planned motion: its torques, and its sudden end."""
        limits, machine = self.limits, self._machine
        self._uncommanded = self._uncommanded + 1 if machine.uncommanded else 0
        speed = float(np.abs(machine.qd_target).max())
        if self._uncommanded > 1 and speed > limits.sudden_stop:
            detail = f"no command at {speed:.2f} rad/s"
            return ErrorCode(codes.PATH_SANITY, codes.SUDDEN_STOP, detail)
        if limits.motion_torque == limits.torque_jump == inf or machine.sensors.dynamics is None:
            return None
        planned, last = machine.sensors.dynamics.torques, self._planned
        self._planned = planned
        shares = np.abs(planned) / self._largest
        joint = int(shares.argmax())
        if shares[joint] > limits.motion_torque:
            return ErrorCode(codes.HIGH_TORQUE, joint, f"{abs(planned[joint]):.0f} Nm")
        if last is not None:
            jumps = np.abs(planned - last) / self._largest
            joint = int(jumps.argmax())
            if jumps[joint] > limits.torque_jump:
                return ErrorCode(codes.TORQUE_JUMP, joint, f"{abs(planned[joint] - last[joint]):.0f} Nm in a tick")
        return None
