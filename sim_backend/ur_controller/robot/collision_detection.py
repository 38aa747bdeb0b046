"""Detection of collisions and of motions beyond the safety limits, of any arm that tells what it plans and measures."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import SafetyLimits
from toolee_robot.sim_backend.ur_controller.robot import error_codes as codes
from toolee_robot.sim_backend.ur_controller.robot.dynamics import Dynamics
from toolee_robot.sim_backend.ur_controller.robot.error_codes import ErrorCode
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel


@dataclass(frozen=True)
class Measured:
    """What is measured in a tick.

    Attributes:
        q: Joint positions, (6,) [rad].
        qd: Joint velocities, (6,) [rad/s].
        twist: Velocity of the TCP, (6,) [m/s, rad/s].
        jacobian: Jacobian of the TCP, (6, 6).
        wrench: Wrench of the environment at the TCP, (6,) [N, Nm], base axes, not zeroed.
    """

    q: Array
    qd: Array
    twist: Array
    jacobian: Array
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
        largest = np.array(model.torque)
        # Each joint's values, a row a kind, and what they are shares of: numpy takes as long for six numbers as for 36.
        self._rows = np.zeros((6, 6))
        self._scales = np.array(
            [
                np.full(6, limits.following_error),
                np.array(limits.joint_position) * np.array(model.position),
                limits.joint_speed * np.array(model.velocity),
                limits.collision_torque * largest,
                largest,
                largest,
            ]
        )
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
        limits, wrench, rows, last = self.limits, measured.wrench, self._rows, self._torques
        share = min(1.0, dt / limits.force_time)
        self._force += share * (wrench[:3] - self._force)
        if min(limits.collision_torque, limits.power) < inf:
            outside = measured.jacobian.T.dot(wrench)
            self._torque += share * (outside - self._torque)
            self._power += share * (abs(float(outside.dot(measured.qd))) - self._power)
        rows[0], rows[1], rows[2], rows[3] = planned.q - measured.q, measured.q, measured.qd, self._torque
        torques = self._torques = None if planned.dynamics is None else planned.dynamics.torques
        rows[4] = 0.0 if torques is None else torques
        rows[5] = 0.0 if torques is None or last is None else torques - last
        self._uncommanded = self._uncommanded + 1 if planned.uncommanded else 0
        shares = np.abs(rows) / self._scales
        largest = shares.max(axis=1).tolist()
        self.deviation_ratio, self.collision_ratio = largest[0], largest[3]
        return (
            self._deviation(shares, largest, planned.payload)
            or self._violation(shares, largest, measured, planned.dynamics)
            or self._collision(shares, largest, planned.payload)
            or self._motion(shares, largest, planned.qd)
        )

    def _deviation(self, shares: Array, largest: list[float], payload: float) -> ErrorCode | None:
        if largest[0] < 1.0:
            return None
        joint = int(shares[0].argmax())
        code = codes.POSITION_DEVIATES if payload > 0.0 else codes.POSITION_DEVIATES_NO_PAYLOAD
        return ErrorCode(code, joint, f"joint {joint} is {abs(self._rows[0, joint]):.2f} rad from its set-point")

    def _violation(
        self, shares: Array, largest: list[float], measured: Measured, dynamics: Dynamics | None
    ) -> ErrorCode | None:
        limits = self.limits
        argument, detail = 0, ""
        force = sqrt(self._force.dot(self._force))
        velocity = measured.twist[:3]
        speed = sqrt(velocity.dot(velocity))
        carried = 0.0 if dynamics is None else sqrt(dynamics.momentum.dot(dynamics.momentum))
        if force > limits.force:
            argument, detail = codes.TORQUE_WINDOW, f"force of {force:.0f} N is over {limits.force:.0f} N"
        elif largest[1] > 1.0:
            argument, detail = codes.JOINT_POSITION, f"joint {int(shares[1].argmax())} is at its limit"
        elif largest[2] > 1.0:
            argument, detail = codes.JOINT_SPEED, f"joint {int(shares[2].argmax())} is too fast"
        elif speed > limits.tcp_speed:
            detail = f"TCP speed of {speed:.2f} m/s is over {limits.tcp_speed:.2f} m/s"
            argument = codes.TCP_SPEED
        elif carried > limits.momentum:
            detail = f"momentum of {carried:.1f} kg m/s is over {limits.momentum:.1f} kg m/s"
            argument = codes.MOMENTUM
        return ErrorCode(codes.SAFETY_VIOLATION, argument, detail) if detail else None

    def _collision(self, shares: Array, largest: list[float], payload: float) -> ErrorCode | None:
        limits = self.limits
        if largest[3] >= 1.0:
            joint = int(shares[3].argmax())
            code = codes.COLLISION if payload > 0.0 else codes.COLLISION_NO_PAYLOAD
            return ErrorCode(code, joint, f"torque of {abs(self._torque[joint]):.0f} Nm from outside")
        if self._power > limits.power:
            detail = f"power of {self._power:.0f} W is over {limits.power:.0f} W"
            return ErrorCode(codes.SAFETY_VIOLATION, codes.POWER, detail)
        return None

    def _motion(self, shares: Array, largest: list[float], qd: Array) -> ErrorCode | None:
        """Errors of the planned motion: its torques, and its sudden end."""
        limits = self.limits
        if self._uncommanded > 1 and (speed := float(np.abs(qd).max())) > limits.sudden_stop:
            detail = f"no command at {speed:.2f} rad/s"
            return ErrorCode(codes.PATH_SANITY, codes.SUDDEN_STOP, detail)
        if largest[4] > limits.motion_torque:
            joint = int(shares[4].argmax())
            return ErrorCode(codes.HIGH_TORQUE, joint, f"{abs(self._rows[4, joint]):.0f} Nm")
        if largest[5] > limits.torque_jump:
            joint = int(shares[5].argmax())
            return ErrorCode(codes.TORQUE_JUMP, joint, f"{abs(self._rows[5, joint]):.0f} Nm in a tick")
        return None
