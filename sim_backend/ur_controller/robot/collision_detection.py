"""The arm's dynamics, and the detection of collisions by what a motion needs."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, inf, sin, sqrt

import numpy as np

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import SafetyLimits
from toolee_robot.sim_backend.ur_controller.robot import error_codes as codes
from toolee_robot.sim_backend.ur_controller.robot.error_codes import ErrorCode
from toolee_robot.sim_backend.ur_controller.robot.kinematics import Chain, chain
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel
from toolee_robot.types import ArmModel

UPRIGHT = np.array([0.0, 0.0, 9.82])
"""Acceleration of an upright base that is equivalent to gravity, as the controller has it, (3,) [m/s^2]."""


_NEXT, _LAST = np.array((1, 2, 0)), np.array((2, 0, 1))
# A link's centre is its frame's origin and two steps along axes of that frame [m], (6, 1) each.
_COM = np.array(ARM_DATA[ArmModel.UR10].link_center_of_mass)  # and of the UR10e
_FIRST = np.array([[_COM[0, 0]], [_COM[1, 0]], [_COM[2, 0]], [_COM[3, 1]], [_COM[4, 2]], [_COM[5, 2]]])
_SECOND = np.array([[_COM[0, 2]], [_COM[1, 2]], [_COM[2, 2]], [_COM[3, 2]], [-_COM[4, 1]], [0.0]])


@dataclass(frozen=True)
class Dynamics:
    """Result of one tick.

    Attributes:
        torques: Joint torques of the set-point's motion, gravity included, (6,) [Nm].
        acceleration: The part that accelerates the arm, (6,) [Nm].
        momentum: Momentum of arm and payload, (3,) [kg m/s], base axes.
        links: Geometry of the arm at the set-point.
    """

    torques: Array
    acceleration: Array
    momentum: Array
    links: Chain


class ArmDynamics:
    """Dynamics of a set-point from one tick to the next.

    Args:
        model: The robot's model.
    """

    def __init__(self, model: ControllerModel) -> None:
        self._masses = np.array([*ARM_DATA[ArmModel(model.name)].link_mass, 0.0])
        self._poses: Array | None = None  # of the flange, in this tick, the last, and the one before
        self._links = np.empty(0)  # centres of the links, likewise
        self._asked: tuple[object, ...] = ()  # what was asked for in the last tick
        self._same = 0  # ticks in a row before it that asked for the same
        self._result: Dynamics | None = None

    def step(self, model: ControllerModel, q: Array, payload: float, cog: Array, gravity: Array, dt: float) -> Dynamics:
        """Advance by one tick.

        Args:
            model: The robot's model, with its DH parameters.
            q: Set-point, (6,) [rad].
            payload: Mass at the flange [kg].
            cog: Its centre of gravity, flange frame, (3,) [m].
            gravity: Acceleration of the base that is equivalent to gravity, (3,) [m/s^2].
            dt: Length of the tick [s].

        Returns:
            Torques and momentum.
        """
        asked = model, q.tobytes(), payload, cog.tobytes(), gravity.tobytes(), dt
        self._same, self._asked = self._same + 1 if asked == self._asked else 0, asked
        if self._result is not None and self._same > 2:  # nothing moves, and all three ticks are alike
            return self._result
        links = chain(model, q)
        masses = self._masses
        masses[6] = payload
        fresh = self._poses is None
        if self._poses is None:
            self._poses, self._links = np.empty((3, 4, 4)), np.empty((3, 6, 3))
        self._poses[1:], self._links[1:] = self._poses[:-1].copy(), self._links[:-1].copy()
        self._poses[0], self._links[0] = links.X_base_flange, _centres(q, links)
        if fresh:
            self._poses[1:], self._links[1:] = self._poses[0], self._links[0]
        centres = np.empty((3, 7, 3))
        centres[:, :6] = self._links
        # A payload that is set anew has not moved there: its present centre is taken in all three ticks.
        centres[:, 6] = self._poses[:, :3, :3] @ cog + self._poses[:, :3, 3]
        momentum = masses.dot(centres[0] - centres[1]) / dt
        forces = np.empty((2, 7, 3))
        forces[0] = masses[:, None] * (centres[0] - 2.0 * centres[1] + centres[2]) / (dt * dt)
        forces[1] = masses[:, None] * gravity
        moving, static = _torques(links, centres[0], forces)
        self._result = Dynamics(static + moving, moving, momentum, links)
        return self._result


def _centres(q: Array, links: Chain) -> Array:
    """Centres of mass of the six links in the base, (6, 3) [m]."""
    q1, a2, q3 = (float(angle) for angle in q[:3])
    s1, c1, a3 = sin(q1), cos(q1), a2 + q3
    z1, z4, z5 = links.axes[1], links.axes[4], links.axes[5]
    x1 = (c1, s1, 0.0)
    x2 = (c1 * cos(a2), s1 * cos(a2), sin(a2))
    x3 = (c1 * cos(a3), s1 * cos(a3), sin(a3))
    # y of frame 4 is z1, of frame 5 it is -z4.
    first, second = np.array((x1, x2, x3, z1, z5, z5)), np.array((z1, z1, z1, z4, z4, z5))
    return links.origins[1:] + _FIRST * first + _SECOND * second


def _torques(links: Chain, centres: Array, forces: Array) -> Array:
    """Torques of the joints that exert forces (n, 7, 3) [N] on the masses; joint i carries those from i on. (n, 6)."""
    both = np.concatenate((forces, cross_rows(centres, forces)), axis=-1)
    carried = both[:, ::-1].cumsum(axis=1)[:, :0:-1]
    torque = carried[..., 3:] - cross_rows(links.origins[:6], carried[..., :3])
    return np.asarray((torque * links.axes).sum(axis=-1))


def cross_rows(a: Array, b: Array) -> Array:
    """Cross products of rows; numpy's own is slow for so few.

    Args:
        a: Left factors, (..., 3).
        b: Right factors, (..., 3).

    Returns:
        The products, (..., 3).
    """
    # `take` copies the same elements as an index does, in half of the time.
    return a.take(_NEXT, -1) * b.take(_LAST, -1) - a.take(_LAST, -1) * b.take(_NEXT, -1)


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
