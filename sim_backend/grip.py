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
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.frames import Array, cross
from toolee_robot.sim_backend.quiet import pb

STIFFNESS = 3e4  # [N/m]
DAMPING = 60.0  # [N s/m]
ANGULAR_STIFFNESS = 500.0  # [Nm/rad]
ANGULAR_DAMPING = 0.5  # [Nm s/rad]
HAND_WIDTH = 0.075  # [m] across the four fingers
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
    def from_contact(cls, normal_force: float, friction: float, handle_radius: float) -> GripLimits:
        """From the sum of the finger forces [N]."""
        n = normal_force
        return cls(friction * n, n, friction * n * handle_radius, (1 + friction) * n * HAND_WIDTH / 4)


class AssistedGrip:
    """The connection of `tool` (a free body) to link `palm` of `robot`; starts at their present relative pose.

    limits: what it transmits. X_inertial_tool: the tool's frame in the body's inertial frame; its z is the handle.
    p_hand_grip: the point (3,) [m] of the palm's frame where the hand holds.
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
        elastic = _bounded(STIFFNESS * u, handle, limits.along, limits.across)
        slip = u - elastic / STIFFNESS
        self._p_rest += slip
        force = _bounded(-elastic - DAMPING * v, handle, limits.along, limits.across)

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
        limits = self.limits
        about = float(phi @ handle)
        spring = float(np.clip(ANGULAR_STIFFNESS * about, -limits.about, limits.about))
        turn = (about - spring / ANGULAR_STIFFNESS) * handle
        tilt = phi - about * handle
        angle = float(np.sqrt(tilt @ tilt))
        self._tilt = angle
        bend = ANGULAR_STIFFNESS * tilt
        if angle * ANGULAR_STIFFNESS > limits.tilting:
            growth = float(w @ tilt) / angle
            bend = tilt * (limits.tilting / angle * (1.0 if growth > 0.0 else 1.0 - TENDON_LOSS))
            turn = turn + tilt * (TILT_SLIP * max(growth, 0.0) * dt / angle)
        damping = ANGULAR_DAMPING * w
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
