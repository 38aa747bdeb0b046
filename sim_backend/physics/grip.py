"""The assisted grip: a bounded, compliant, slipping connection between palm and handle.

Fingers of capsules on a handle of polygons roll and creep in a rigid-body engine (a round handle turned by 144 deg in
a swing). So once the fingers hold by real contact, hand and tool stop colliding and this law takes over. Both are
joined at the grip by a spring and damper whose force never exceeds what the measured finger forces allow:

    along the handle     mu * sum(N)                     friction
    across the handle    sum(N)                          the fingers open beyond
    about the handle     mu * sum(N) * r                 friction at the handle's radius r
    tilting the handle   (1 + mu) * sum(N) * w / 4       couple of normal forces and friction over the hand's width w

Beyond the bounds of friction (along, across, about) the handle slips: its rest pose moves, and the slip adds up.
Beyond the bound of tilting it is the fingers that give way, with the torque of their motors, and they close again:
the torque stays at its bound, comes back weaker by the tendons' friction, and a share of the excursion is left as
slip. Past `RELEASE_SLIP` or `RELEASE_ANGLE` of slip, or `RELEASE_TILT` of tilt, the handle has left the hand.

The engine integrates an applied force explicitly, so a spring and damper that are too stiff for what they hold feed
energy into it: a hammer turns about its handle with an inertia of 1.3e-4 to 9e-4 kg m^2, and 0.5 Nm s/rad over a step
of 1 ms diverge below 2.5e-4. The connection therefore gets the stiffness and damping at which explicit steps are stable
for the tool in the hand (`GripGains.stable`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.frames import Array, cross
from toolee_robot.sim_backend.physics.bullet import pb, quiet

STIFFNESS = 3e4  # [N/m], at most
DAMPING = 60.0  # [N s/m], at most
ANGULAR_STIFFNESS = 500.0  # [Nm/rad], at most
ANGULAR_DAMPING = 0.5  # [Nm s/rad], at most
STABILITY_NUMBER = 1.0  # at most, of each motion; explicit steps are stable below 4 / 3 (GripGains.stable)
TENDON_LOSS = 0.4  # of the tilting torque, while the fingers close again
TILT_SLIP = 0.015  # of a tilt beyond the bound that stays
RELEASE_SLIP = 0.030  # [m]
RELEASE_ANGLE = np.deg2rad(50.0)
RELEASE_TILT = np.deg2rad(50.0)


@dataclass(frozen=True)
class GripLimits:
    """Bounds of what the grip transmits: force along and across the handle [N], torque about and across it [Nm]."""

    along: float
    across: float
    about: float
    tilting: float

    @classmethod
    def from_contact(cls, normal_force: float, friction: float, handle_radius: float, width: float) -> GripLimits:
        """From the sum of the finger forces [N]; width: of the hand along the handle, `HandModel.grip_width` [m]."""
        n = normal_force
        return cls(friction * n, n, friction * n * handle_radius, (1 + friction) * n * width / 4)


@dataclass(frozen=True)
class GripGains:
    """Stiffness and damping of the connection, isotropic in each of its three motions.

    Attributes:
        stiffness: Of a shift of the grip point [N/m].
        damping: Of a shift [N s/m].
        about_stiffness: Of a turn about the handle [Nm/rad].
        about_damping: Of a turn about the handle [Nm s/rad].
        tilt_stiffness: Of a tilt of the handle [Nm/rad].
        tilt_damping: Of a tilt [Nm s/rad].
    """

    stiffness: float
    damping: float
    about_stiffness: float
    about_damping: float
    tilt_stiffness: float
    tilt_damping: float

    @classmethod
    def stable(cls, mobility: Array, handle: Array, time_step: float) -> GripGains:
        """The stiffest connection, up to the constants above, that explicit steps of this length keep passive.

        Semi-implicit Euler steps h of M a = -K x - D v are stable where M - h D / 2 - h^2 K / 4 is positive definite,
        that is, where every eigenvalue of (h^2 K + 2 h D) M^-1 is below 4. K and D are block diagonal over shift, turn
        and tilt, and M^-1 <= 3 blockdiag(M^-1), as for any positive semidefinite matrix of three blocks. So
        (h^2 k + 2 h d) w < 4 / 3 in each block is enough, with w the largest eigenvalue of its inverse inertia.

        Args:
            mobility: (6, 6) inverse inertia [1/kg, 1/(kg m), 1/(kg m^2)] of tool against palm at the grip point: the
                relative acceleration (linear, angular) that a unit wrench (force, torque) between the two causes.
            handle: (3,) unit vector along the handle, in the same axes.
            time_step: The longest step [s] that is made.
        """
        linear, angular = mobility[:3, :3], mobility[3:, 3:]
        across = np.eye(3) - np.outer(handle, handle)
        w_shift = float(np.linalg.eigvalsh(linear)[-1])
        w_about = float(handle @ angular @ handle)
        w_tilt = float(np.linalg.eigvalsh(across @ angular @ across)[-1])

        def limited(stiffness: float, damping: float, w: float) -> tuple[float, float]:
            scale = min(1.0, STABILITY_NUMBER / ((time_step**2 * stiffness + 2.0 * time_step * damping) * w))
            return scale * stiffness, scale * damping

        return cls(
            *limited(STIFFNESS, DAMPING, w_shift),
            *limited(ANGULAR_STIFFNESS, ANGULAR_DAMPING, w_about),
            *limited(ANGULAR_STIFFNESS, ANGULAR_DAMPING, w_tilt),
        )


class AssistedGrip:
    """The connection of `tool` (a free body) to link `palm` of `robot`; starts at their present relative pose.

    limits: what it transmits. X_inertial_tool: the tool's frame in the body's inertial frame; its z is the handle.
    p_hand_grip: the point (3,) [m] of the palm's frame where the hand holds. time_step: the longest step [s] that the
    world makes.
    """

    def __init__(
        self,
        client: int,
        robot: int,
        palm: int,
        tool: int,
        X_inertial_tool: Array,
        p_hand_grip: Array,
        limits: GripLimits,
        time_step: float,
    ) -> None:
        self.limits = limits
        self.holding = True
        self._client, self._robot, self._palm, self._tool = client, robot, palm, tool
        self._R_inertial_tool = X_inertial_tool[:3, :3]
        p_palm, R_palm, p_tool, R_tool = self._poses()
        self._anchor = R_tool.T @ (p_palm + R_palm @ p_hand_grip - p_tool)  # in the tool's inertial frame
        self._p_rest = np.array(p_hand_grip, dtype=float)  # where the anchor rests, palm frame
        self._R_rest = R_palm.T @ R_tool @ self._R_inertial_tool  # the tool's axes at rest, palm frame
        self._p_start, self._R_start = self._p_rest.copy(), self._R_rest.copy()
        mobility = _palm_mobility(client, robot, palm, self._p_rest) + _tool_mobility(
            client, tool, R_palm.T @ R_tool, R_palm.T @ R_tool @ self._anchor
        )
        self.gains = GripGains.stable(mobility, self._R_rest[:, 2], time_step)
        self._tilt = 0.0
        self.force, self.torque = np.zeros(3), np.zeros(3)

    def _poses(self) -> tuple[Array, Array, Array, Array]:
        state = pb.getLinkState(self._robot, self._palm, physicsClientId=self._client)
        p, q = pb.getBasePositionAndOrientation(self._tool, physicsClientId=self._client)
        return np.array(state[4]), _matrix(state[5]), np.array(p), _matrix(q)

    @property
    def slip(self) -> float:
        """How far the handle has moved in the hand for good since the grip began [m]."""
        return float(np.linalg.norm(self._p_rest - self._p_start))

    @property
    def slip_angle(self) -> float:
        """How far it has turned in the hand for good [rad]."""
        turn = _rotation_vector(self._R_start.T @ self._R_rest)
        return float(np.sqrt(turn @ turn))

    def before_step(self, dt: float) -> None:
        """Apply the grip's force and torque for the step of dt [s] to come; let go when it has slipped too far."""
        if not self.holding:
            return
        state = pb.getLinkState(self._robot, self._palm, computeLinkVelocity=1, physicsClientId=self._client)
        p, q = pb.getBasePositionAndOrientation(self._tool, physicsClientId=self._client)
        v_tool, w_tool = (np.array(v) for v in pb.getBaseVelocity(self._tool, physicsClientId=self._client))
        R_palm, R_tool = _matrix(state[5]), _matrix(q)
        R = R_palm.T @ R_tool @ self._R_inertial_tool
        arm = R_tool @ self._anchor
        point = np.array(p) + arm
        v = v_tool + cross(w_tool, arm) - np.array(state[6]) - cross(np.array(state[7]), point - np.array(state[0]))
        v = R_palm.T @ v
        handle = R[:, 2]
        limits = self.limits

        u = R_palm.T @ (point - np.array(state[4])) - self._p_rest
        gains = self.gains
        elastic = _bounded(gains.stiffness * u, handle, limits.along, limits.across)
        slip = u - elastic / gains.stiffness
        self._p_rest += slip
        force = _bounded(-elastic - gains.damping * v, handle, limits.along, limits.across)

        phi = _rotation_vector(R @ self._R_rest.T)
        torque, turn = self._twist(phi, R_palm.T @ (w_tool - np.array(state[7])), handle, dt)
        if turn @ turn > 1e-20:
            self._R_rest = _rotation(turn) @ self._R_rest

        self.force, self.torque = force, torque
        if self.slip > RELEASE_SLIP or self.slip_angle > RELEASE_ANGLE or self._tilt > RELEASE_TILT:
            self.release()
            return
        self._apply(R_palm @ force, R_palm @ torque, point)

    def _twist(self, phi: Array, w: Array, handle: Array, dt: float) -> tuple[Array, Array]:
        """Torque on the tool and how its rest pose turns, both (3,) in the palm's axes, for a deflection phi [rad] that
        changes at w [rad/s]."""
        limits, gains = self.limits, self.gains
        about = float(phi @ handle)
        spring = float(np.clip(gains.about_stiffness * about, -limits.about, limits.about))
        turn = (about - spring / gains.about_stiffness) * handle
        tilt = phi - about * handle
        angle = float(np.sqrt(tilt @ tilt))
        self._tilt = angle
        bend = gains.tilt_stiffness * tilt
        if angle * gains.tilt_stiffness > limits.tilting:
            growth = float(w @ tilt) / angle
            bend = tilt * (limits.tilting / angle * (1.0 if growth > 0.0 else 1.0 - TENDON_LOSS))
            turn = turn + tilt * (TILT_SLIP * max(growth, 0.0) * dt / angle)
        w_about = float(w @ handle) * handle
        damping = gains.about_damping * w_about + gains.tilt_damping * (w - w_about)
        torque = _bounded(-spring * handle - bend - damping, handle, limits.about, limits.tilting)
        return torque, turn

    def _apply(self, force: Array, torque: Array, point: Array) -> None:
        at = point.tolist()
        for body, link, sign in ((self._tool, -1, 1.0), (self._robot, self._palm, -1.0)):
            pb.applyExternalForce(body, link, (sign * force).tolist(), at, pb.WORLD_FRAME, physicsClientId=self._client)
            pb.applyExternalTorque(body, link, (sign * torque).tolist(), pb.WORLD_FRAME, physicsClientId=self._client)

    def release(self) -> None:
        """Let go for good."""
        self.holding = False
        self.force, self.torque = np.zeros(3), np.zeros(3)


def _tool_mobility(client: int, tool: int, R: Array, arm: Array) -> Array:
    """Inverse inertia (6, 6) of a free body at a point, in the axes of a frame.

    Args:
        client: pybullet's.
        tool: The body.
        R: (3, 3) the body's inertial axes in the frame.
        arm: (3,) [m] from the body's centre of mass to the point, in the frame's axes.
    """
    mass, _, moments = pb.getDynamicsInfo(tool, -1, physicsClientId=client)[:3]
    angular = R @ np.diag(1.0 / np.array(moments)) @ R.T
    x, y, z = arm
    cross_arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    coupling = -cross_arm @ angular
    return np.block([[np.eye(3) / mass + coupling @ cross_arm, coupling], [coupling.T, angular]])


def _palm_mobility(client: int, robot: int, palm: int, p_hand_grip: Array) -> Array:
    """Inverse inertia (6, 6) of the palm at the grip point in the palm's axes, no joint's motor holding: as much as the
    palm can give way when the motors are at their bounds."""
    links = range(pb.getNumJoints(robot, physicsClientId=client))
    joints = [i for i in links if pb.getJointInfo(robot, i, physicsClientId=client)[2] != pb.JOINT_FIXED]
    if not joints:
        return np.zeros((6, 6))
    q = [state[0] for state in pb.getJointStates(robot, joints, physicsClientId=client)]
    zeros = [0.0] * len(q)
    state = pb.getLinkState(robot, palm, physicsClientId=client)
    R_palm = _matrix(state[5])
    # pybullet takes the point in the link's inertial frame.
    point = _matrix(state[3]).T @ (p_hand_grip - np.array(state[2]))
    with quiet(1):  # it warns of axes of the URDF that are of unit length in single precision only
        linear, angular = pb.calculateJacobian(robot, palm, point.tolist(), q, zeros, zeros, physicsClientId=client)
        M = np.array(pb.calculateMassMatrix(robot, q, physicsClientId=client))
    J = np.vstack([R_palm.T @ np.array(linear), R_palm.T @ np.array(angular)])
    return np.asarray(J @ np.linalg.solve(M, J.T))


def _matrix(quaternion: tuple[float, ...]) -> Array:
    return np.array(pb.getMatrixFromQuaternion(quaternion)).reshape(3, 3)


def _rotation_vector(R: Array) -> Array:
    """Axis times angle [rad] of a 3x3 rotation of less than 180 deg; scipy's takes ten times as long for one."""
    v = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = 0.5 * float(np.sqrt(v @ v))
    if sine < 1e-9:
        return 0.5 * v
    return v * (float(np.arctan2(sine, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0))) / (2.0 * sine))


def _rotation(turn: Array) -> Array:
    """3x3 of a rotation vector [rad]."""
    angle = float(np.sqrt(turn @ turn))
    return _matrix(pb.getQuaternionFromAxisAngle((turn / angle).tolist(), angle))


def _bounded(vector: Array, axis: Array, along: float, across: float) -> Array:
    """The vector (3,) with its part along `axis` and the rest each cut to a length."""
    a = float(vector @ axis)
    rest = vector - a * axis
    length = float(np.sqrt(rest @ rest))
    if length > across:
        rest = rest * (across / length)
    return min(max(a, -along), along) * axis + rest
