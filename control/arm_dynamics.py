"""Rigid-body dynamics of the arm with the tool held: joint torques, and what a strike asked of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pinocchio as pin
from scipy.signal import savgol_filter

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import LimitError
from toolee_robot.frames import Array, inverse
from toolee_robot.hal import MotionReport
from toolee_robot.station import StrikeConfig
from toolee_robot.types import ArmModel, Payload, Trajectory


class ArmDynamics:
    """Dynamics of the six arm joints.

    Args:
        robot: Kinematic model of arm and hand.
        q_hand: Joint positions at which the hand is locked, (n,) [rad].
        X_hand_ee: Pose of the end effector in the hand, (4, 4).
        tool: Mass of the tool [kg], a point at its centre of mass, which is given in the end effector's frame [m].
    """

    def __init__(self, robot: RobotModel, q_hand: Array, X_hand_ee: Array, tool: Payload) -> None:
        hand = [robot.model.getJointId(name) for name in robot.description.hand_joints]
        self.model = pin.buildReducedModel(robot.model, hand, robot.configuration(np.zeros(6), q_hand))
        X = robot.arm.X_joint6_flange @ robot.X_flange_hand(q_hand) @ X_hand_ee
        at = pin.SE3(np.eye(3), X[:3, :3] @ tool.center_of_mass + X[:3, 3])
        self.model.appendBodyToJoint(6, pin.Inertia(tool.mass, np.zeros(3), np.zeros((3, 3))), at)
        self._data = self.model.createData()

    @classmethod
    def with_payload(cls, robot: RobotModel, q_hand: Array, payload: Payload | None) -> Self:
        """Dynamics of the arm with its hand and, as a point mass, what the payload has besides.

        Args:
            robot: Kinematic model of arm and hand.
            q_hand: Joint positions at which the hand is locked, (n,) [rad].
            payload: What the flange carries, hand and tool together, in the flange's frame; None for the hand alone.

        Returns:
            The dynamics.
        """
        hand = robot.description.hand_payload(q_hand)
        payload = hand if payload is None else payload
        mass = max(payload.mass - hand.mass, 0.0)
        moment = payload.mass * payload.center_of_mass - hand.mass * hand.center_of_mass
        tool = Payload(mass, moment / mass if mass > 1e-6 else np.zeros(3))
        return cls(robot, q_hand, inverse(robot.X_flange_hand(q_hand)), tool)

    def torques(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Compute the joint torques of a motion by inverse dynamics.

        Args:
            q: Joint positions, (N, 6) [rad].
            qd: Joint velocities, (N, 6) [rad/s].
            qdd: Joint accelerations, (N, 6) [rad/s^2].

        Returns:
            Torques, (N, 6) [Nm].
        """
        return np.stack([pin.rnea(self.model, self._data, *row) for row in zip(q, qd, qdd, strict=True)])

    def derivatives(self, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array, Array, Array]:
        """Compute the torques and their derivatives.

        Args:
            q: Joint positions, (N, 6) [rad].
            qd: Joint velocities, (N, 6) [rad/s].
            qdd: Joint accelerations, (N, 6) [rad/s^2].

        Returns:
            Torques, (N, 6) [Nm], and their derivatives with respect to q, qd and qdd, (N, 6, 6) each.
        """
        n, data = len(q), self._data
        tau, by_q, by_qd, by_qdd = np.empty((n, 6)), np.empty((n, 6, 6)), np.empty((n, 6, 6)), np.empty((n, 6, 6))
        for i in range(n):
            pin.computeRNEADerivatives(self.model, data, q[i], qd[i], qdd[i])
            tau[i], by_q[i], by_qd[i], by_qdd[i] = data.tau, data.dtau_dq, data.dtau_dv, _symmetric(data.M)
        return tau, by_q, by_qd, by_qdd

    def momentum_maps(self, q: Array) -> Array:
        """Compute the maps of joint velocities to the momentum of arm, hand and tool.

        Args:
            q: Joint positions, (N, 6) [rad].

        Returns:
            The maps, (N, 3, 6) [kg m]; the momentum is in `base`.
        """
        maps = np.stack([pin.jacobianCenterOfMass(self.model, self._data, row) for row in q])
        return np.asarray(self._data.mass[0] * maps)

    def momentum(self, q: Array, qd: Array) -> Array:
        """Compute the size of the momentum of arm, hand and tool.

        Args:
            q: Joint positions, (N, 6) [rad].
            qd: Joint velocities, (N, 6) [rad/s].

        Returns:
            The momentum, (N,) [kg m/s].
        """
        return np.asarray(np.linalg.norm(np.einsum("nij,nj->ni", self.momentum_maps(q), qd), axis=1))

    def at_rest(self, q: Array) -> tuple[Array, Array]:
        """Compute the inertia, (6, 6) [kg m^2], and the gravity's torques, (6,) [Nm], at joint positions q, (6,)."""
        M = _symmetric(pin.crba(self.model, self._data, q))
        return M, pin.computeGeneralizedGravity(self.model, self._data, q).copy()


_UPPER, _ABOVE = np.triu(np.ones((6, 6))), np.triu(np.ones((6, 6)), 1)


def _symmetric(M: Array) -> Array:
    """Complete a matrix of which Pinocchio fills the upper triangle."""
    return np.asarray(_UPPER * M + (_ABOVE * M).T)


TORQUE_SHARE = 0.9
"""Share of the joints' rated torques that the inverse dynamics of a strike may take. The rest is for what is not
modelled: friction, the motors' rotors, errors of the masses."""
MOST_BRAKING = 1e3
"""Deceleration that stands for no bound [rad/s^2]."""
_STILL = 1e-6  # [rad/s]


def torque_use(dynamics: ArmDynamics, trajectory: Trajectory, torque: Array) -> Array:
    """Compute what a motion takes of the torques that are left beside gravity's.

    Args:
        dynamics: Dynamics of arm, hand and tool.
        trajectory: The motion, N samples.
        torque: Permitted torques, (6,) [Nm].

    Returns:
        The largest share over the joints at each sample, (N,); above 1 the motion takes more than is permitted.

    Raises:
        LimitError: Gravity alone exceeds a torque; code `limit.torque`.
    """
    rest = np.zeros_like(trajectory.q)
    static = dynamics.torques(trajectory.q, rest, rest)
    dynamic = dynamics.torques(trajectory.q, trajectory.qd, trajectory.qdd) - static
    room = torque - np.sign(dynamic) * static
    if np.any(room <= 0):
        raise LimitError("holding the arm takes more torque than is permitted", code="limit.torque")
    return np.asarray(np.max(np.abs(dynamic) / room, axis=1))


def permitted_braking(dynamics: ArmDynamics, trajectory: Trajectory, torque: Array) -> Array:
    """Compute how hard a stop on a motion's path may brake within the joints' torques.

    With e the unit tangent of the path in joint space, v the speed along it and P the part of the planned acceleration
    across it, a stop at the share r of the planned speed takes

        tau = g(q) + r^2 (M P + C(q, q')) + M e v'

    (Bobrow, Dubowsky and Gibson, "Time-optimal control of robotic manipulators along specified paths", 1985). It is
    linear in r^2 and v', so that between r = 0 and r = 1 everything is permitted that lies between what they permit, in
    proportion to r^2.

    Args:
        dynamics: Dynamics of arm, hand and tool.
        trajectory: The motion, N samples.
        torque: Permitted torques, (6,) [Nm].

    Returns:
        The largest deceleration along the path at each sample, at rest and at the planned speed, (N, 2) [rad/s^2], at
        most MOST_BRAKING; 0 or less where gravity and speed alone exceed a torque.
    """
    speed = np.linalg.norm(trajectory.qd, axis=1)
    moving = speed > _STILL
    if not np.any(moving):
        return np.full((len(speed), 2), MOST_BRAKING)
    q, qd, qdd = trajectory.q[moving], trajectory.qd[moving], trajectory.qdd[moving]
    e = qd / speed[moving, None]
    across = qdd - np.sum(e * qdd, axis=1)[:, None] * e
    rest = np.zeros_like(q)
    standing = dynamics.torques(q, rest, rest)
    by_braking = standing - dynamics.torques(q, rest, e)  # per unit of deceleration
    along = np.maximum(np.abs(by_braking), 1e-9)
    permitted = []
    for tau in (standing, dynamics.torques(q, qd, across)):
        room = torque - np.sign(by_braking) * tau
        braking = np.minimum(np.min(room / along, axis=1), MOST_BRAKING)
        # At rest, where the path has no tangent: as where it begins or ends to move.
        permitted.append(np.interp(trajectory.times, trajectory.times[moving], braking))
    return np.stack(permitted, axis=1)


def bound_stop(trajectory: Trajectory, dynamics: ArmDynamics, model: ArmModel) -> Trajectory:
    """Bound the stops on a motion by TORQUE_SHARE of the joints' torques, and by the braking that it came with.

    Args:
        trajectory: The motion.
        dynamics: Dynamics of arm, hand and tool.
        model: Model of the arm.

    Returns:
        The motion, with its permitted braking.
    """
    braking = permitted_braking(dynamics, trajectory, TORQUE_SHARE * np.array(ARM_DATA[model].torque))
    if trajectory.braking is not None:
        braking = np.minimum(braking, trajectory.braking)
    return replace(trajectory, braking=braking)


BEFORE, AFTER = 0.016, 0.080
"""Time before and after the detected contact over which the force is integrated [s]."""
SMOOTHING = 0.024
"""Time over which a parabola gives velocity and acceleration of the command [s]: three samples at 125 Hz. A single late
command must not seem an acceleration."""


@dataclass(frozen=True)
class StrikeLoad:
    """Load of the arm in one strike.

    Attributes:
        impulse: Integral of the force on the flange around the contact [N s]; 0 without a contact.
        torque_share: Largest torque of a joint as a share of its largest one: rigid-body inverse dynamics of the
            commanded motion with the measured wrench. Friction, rotors, and impacts that are shorter than the arm's
            cycle are not in it.
        position_deviation_ratio: The controller's largest ratio in the strike; see `hal.ArmState`. None where it has
            none.
        collision_ratio: Likewise.
    """

    impulse: float
    torque_share: float
    position_deviation_ratio: float | None = None
    collision_ratio: float | None = None

    def excess(self, strike: StrikeConfig) -> str:
        """Tell what of it exceeds the limits above which no further strike is made.

        Args:
            strike: The limits.

        Returns:
            What exceeds them, and what to lower; empty if nothing does.
        """
        advice = "lower strike.speed and arm.acceleration, or take a lighter tool"
        ratios = {
            "joint position deviation ratio": (self.position_deviation_ratio, f"{advice}; toolee arm lag tunes servoj"),
            "collision detection ratio": (self.collision_ratio, f"{advice}, or a softer mount"),
        }
        for name, (ratio, change) in ratios.items():
            if ratio is not None and not ratio <= strike.max_load:  # NaN included
                return (
                    f"the last strike took the robot's {name} to {ratio:.2f}; at 1 it stops itself, strike.max_load "
                    f"allows {strike.max_load:g}: {change}"
                )
        if not self.torque_share <= strike.max_torque_share:
            return (
                f"the last strike took {self.torque_share:.2f} of a joint's largest torque, strike.max_torque_share "
                f"allows {strike.max_torque_share:g}: {advice}, or move the block nearer to the arm"
            )
        return ""


def strike_load(
    report: MotionReport, robot: RobotModel, q_hand: Array, payload: Payload, model: ArmModel
) -> StrikeLoad:
    """Compute the load of an executed strike.

    Args:
        report: The executed motion.
        robot: Kinematic model of arm and hand.
        q_hand: Joint positions of the hand, wrist first, (n,) [rad].
        payload: What the flange carries, hand and tool together.
        model: Model of the arm.

    Returns:
        The load.
    """
    t, q = report.stamps, report.q_commanded
    share = 0.0
    if len(t) >= 3:
        # The commands have an even period; the stamps jitter by the delay of their arrival.
        period = float(t[-1] - t[0]) / (len(t) - 1)
        rows = min(2 * round(SMOOTHING / period / 2) + 1, len(t) - 1 + len(t) % 2)
        qd, qdd = (savgol_filter(q, rows, 2, deriv=n, delta=period, axis=0) for n in (1, 2))
        torques = ArmDynamics.with_payload(robot, q_hand, payload).torques(q, qd, qdd)
        torques -= np.einsum("nij,ni->nj", robot.arm.fk_jacobian(q)[1], report.wrenches)
        share = float(np.max(np.abs(torques) / ARM_DATA[model].torque))
    impulse = 0.0
    if report.contact is not None and len(t) >= 2:
        near = (t >= report.contact.stamp - BEFORE) & (t <= report.contact.stamp + AFTER)
        impulse = float(np.linalg.norm(np.trapezoid(report.wrenches[near, :3], t[near], axis=0)))
    return StrikeLoad(impulse, share, _largest(report.position_deviation_ratios), _largest(report.collision_ratios))


def _largest(ratios: Array | None) -> float | None:
    return None if ratios is None or len(ratios) == 0 else float(np.max(ratios))
