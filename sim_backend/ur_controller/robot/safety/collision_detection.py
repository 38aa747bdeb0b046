"""Detection of collisions and of motions beyond the safety limits, of any arm that tells what it plans and measures."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from toolee_robot.frames import Array, cross
from toolee_robot.sim_backend.ur_controller.profile import SafetyLimits
from toolee_robot.sim_backend.ur_controller.robot.dynamics import Dynamics
from toolee_robot.sim_backend.ur_controller.robot.model import ControllerModel
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
        wrench: Wrench of the environment at the flange's origin, (6,) [N, Nm], base axes, not zeroed.
    """

    q: Array
    qd: Array
    twist: Array
    jacobian: Array
    arm: Array
    wrench: Array


@dataclass(frozen=True)
class Planned:
    """What the controller plans in a tick.

    Attributes:
        q: Set-point at its end, (6,) [rad].
        qd: Velocity of the set-point, (6,) [rad/s].
        payload: Mass that the controller takes for its payload [kg].
        dynamics: Torques and momentum of the set-point's motion; None where nothing computes them.
        uncommanded: Whether the program has let go of the arm during its motion.
    """

    q: Array
    qd: Array
    payload: float
    dynamics: Dynamics | None
    uncommanded: bool = False


class CollisionDetection:
    """Compares what is measured with what is planned, tick by tick.

    Args:
        model: The robot's model.
        limits: The limits.

    Attributes:
        limits: The limits.
        deviation_ratio: Largest deviation of a joint from its set-point over its limit; 1 stops the arm.
        collision_ratio: Largest torque of the environment at a joint over its limit, likewise.
    """

    def __init__(self, model: ControllerModel, limits: SafetyLimits) -> None:
        self.limits = limits
        self.deviation_ratio = self.collision_ratio = 0.0
        self._largest = np.array(model.torque)
        self._range = np.array(limits.joint_position) * np.array(model.position)
        self._fastest = limits.joint_speed * np.array(model.velocity)
        self._force = np.zeros(3)
        self._torque = np.zeros(6)
        self._power = 0.0
        self._torques: Array | None = None
        self._uncommanded = 0

    def forget(self) -> None:
        """Start again, as after a stop."""
        self._force, self._torque, self._power = np.zeros(3), np.zeros(6), 0.0
        self._torques, self._uncommanded = None, 0
        self.collision_ratio = 0.0

    def step(self, dt: float, measured: Measured, planned: Planned) -> ErrorCode | None:
        """Check a tick.

        Args:
            dt: Length of the tick [s].
            measured: What was measured in it.
            planned: What was planned for it.

        Returns:
            The error that stops the arm, or None.
        """
        limits, wrench = self.limits, measured.wrench
        share = min(1.0, dt / limits.force_time)
        self._force += share * (wrench[:3] - self._force)
        found = self._deviation(measured, planned) or self._violation(measured, planned)
        if min(limits.collision_torque, limits.power) < inf:
            at_tcp = np.concatenate([wrench[:3], wrench[3:] - cross(measured.arm, wrench[:3])])
            outside = measured.jacobian.T @ at_tcp
            self._torque += share * (outside - self._torque)
            self._power += share * (abs(float(outside @ measured.qd)) - self._power)
            found = found or self._collision(planned)
        return found or self._motion(planned)

    def _deviation(self, measured: Measured, planned: Planned) -> ErrorCode | None:
        limit = self.limits.following_error
        error = np.abs(planned.q - measured.q)
        joint = int(error.argmax())
        self.deviation_ratio = float(error[joint]) / limit
        if self.deviation_ratio < 1.0:
            return None
        code = codes.POSITION_DEVIATES if planned.payload > 0.0 else codes.POSITION_DEVIATES_NO_PAYLOAD
        return ErrorCode(code, joint, f"joint {joint} is {error[joint]:.2f} rad from its set-point")

    def _collision(self, planned: Planned) -> ErrorCode | None:
        limits = self.limits
        ratios = np.abs(self._torque) / (limits.collision_torque * self._largest)
        joint = int(ratios.argmax())
        self.collision_ratio = float(ratios[joint])
        if self.collision_ratio >= 1.0:
            code = codes.COLLISION if planned.payload > 0.0 else codes.COLLISION_NO_PAYLOAD
            return ErrorCode(code, joint, f"torque of {abs(self._torque[joint]):.0f} Nm from outside")
        if self._power > limits.power:
            detail = f"power of {self._power:.0f} W is over {limits.power:.0f} W"
            return ErrorCode(codes.SAFETY_VIOLATION, codes.POWER, detail)
        return None

    def _violation(self, measured: Measured, planned: Planned) -> ErrorCode | None:
        limits = self.limits
        argument, detail = 0, ""
        force = float(np.sqrt(self._force @ self._force))
        over = np.abs(measured.qd) - self._fastest
        speed = float(np.sqrt(measured.twist[:3] @ measured.twist[:3]))
        dynamics = planned.dynamics
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

    def _motion(self, planned: Planned) -> ErrorCode | None:
        """Errors of the planned motion: its torques, and its sudden end."""
        limits = self.limits
        self._uncommanded = self._uncommanded + 1 if planned.uncommanded else 0
        speed = float(np.abs(planned.qd).max())
        if self._uncommanded > 1 and speed > limits.sudden_stop:
            detail = f"no command at {speed:.2f} rad/s"
            return ErrorCode(codes.PATH_SANITY, codes.SUDDEN_STOP, detail)
        if limits.motion_torque == limits.torque_jump == inf or planned.dynamics is None:
            return None
        torques, last = planned.dynamics.torques, self._torques
        self._torques = torques
        shares = np.abs(torques) / self._largest
        joint = int(shares.argmax())
        if shares[joint] > limits.motion_torque:
            return ErrorCode(codes.HIGH_TORQUE, joint, f"{abs(torques[joint]):.0f} Nm")
        if last is not None:
            jumps = np.abs(torques - last) / self._largest
            joint = int(jumps.argmax())
            if jumps[joint] > limits.torque_jump:
                return ErrorCode(codes.TORQUE_JUMP, joint, f"{abs(torques[joint] - last[joint]):.0f} Nm in a tick")
        return None
