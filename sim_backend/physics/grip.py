"""The assisted grip: a bounded, compliant, slipping connection between palm and handle.

In a rigid-body engine, capsule fingers on a polygonal handle roll and creep (a round handle turned by 144 deg in a
swing). Therefore, once the fingers hold by real contact, collisions between hand and tool are disabled and this model
replaces them: a spring and damper at the grip whose force is bounded by what the measured finger forces allow:

    along the handle     mu * sum(N)                     friction
    about the handle     mu * sum(N) * r                 friction at the handle's radius r
    across the handle    sum(N)                          beyond it the fingers open
    tilting the handle   (1 + mu) * sum(N) * w / 4       couple of normal forces and friction over the hand's width w

Force along and torque about the handle share the same friction: together they lie within an ellipse, the usual
approximation of a contact's limit surface (Goyal, Ruina and Papadopoulos, 1991; Howe and Cutkosky, 1996). Beyond it,
and beyond the bound across, the handle slips: its rest pose moves, and the slip accumulates.
Beyond the bound of tilting the fingers yield at the torque of their motors and close again: the torque stays at its
bound, is smaller by the tendons' friction on the way back, and a fraction of the excursion remains as slip. Between the
two it changes as the spring's does (a Prandtl element), so that a handle that rings there meets no jumps. Beyond
`RELEASE_SLIP` or `RELEASE_ANGLE` of slip, or `RELEASE_TILT` of tilt, the hand has lost the handle.

The engine integrates applied forces explicitly, so a spring and damper that are too stiff for the tool add energy: a
hammer's inertia about its handle is 1.3e-4 to 9e-4 kg m^2, and 0.5 Nm s/rad with steps of 1 ms diverge below 2.5e-4.
Stiffness and damping are therefore limited to what explicit steps keep stable for the tool (`GripGains.stable`).

All of this is computed in every step, in the world's axes and in Python's floats: numpy takes several times as long for
three numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.physics.bodies import Vector, pb, quiet, rotation_matrix, turned

STIFFNESS = 3e4  # [N/m], at most
DAMPING = 60.0  # [N s/m], at most
ANGULAR_STIFFNESS = 500.0  # [Nm/rad], at most
ANGULAR_DAMPING = 0.5  # [Nm s/rad], at most
STABILITY_NUMBER = 1.0  # upper bound for each motion; explicit steps are stable below 4 / 3 (GripGains.stable)


@dataclass(frozen=True)
class GripGains:
    """Stiffness and damping of the connection, isotropic in each of its three motions.

    Attributes:
        stiffness: Stiffness against a shift of the grip point [N/m].
        damping: Damping of a shift [N s/m].
        about_stiffness: Stiffness against a rotation about the handle [Nm/rad].
        about_damping: Damping of a rotation about the handle [Nm s/rad].
        tilt_stiffness: Stiffness against a tilt of the handle [Nm/rad].
        tilt_damping: Damping of a tilt [Nm s/rad].
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
            time_step: The longest time step [s].

        Returns:
            The gains.
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


def tool_mobility(client: int, tool: int, R: Array, arm: Array) -> Array:
    """Inverse inertia (6, 6) of a free body at a point, in the axes of a frame.

    Args:
        client: pybullet's physics client.
        tool: pybullet's id of the body.
        R: The body's inertial axes in the frame, (3, 3).
        arm: Vector from the body's centre of mass to the point, (3,) [m], in the frame's axes.

    Returns:
        The inverse inertia.
    """
    mass, _, moments = pb.getDynamicsInfo(tool, -1, physicsClientId=client)[:3]
    angular = R @ np.diag(1.0 / np.array(moments)) @ R.T
    x, y, z = arm
    cross_arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    coupling = -cross_arm @ angular
    return np.block([[np.eye(3) / mass + coupling @ cross_arm, coupling], [coupling.T, angular]])


def palm_mobility(client: int, robot: int, palm: int, p_hand_grip: Array) -> Array:
    """Inverse inertia (6, 6) of the palm at the grip point, palm's axes, with all joints free.

    This is an upper bound, which holds when the motors are saturated.

    Args:
        client: pybullet's physics client.
        robot: pybullet's id of the robot.
        palm: Index of the palm's link.
        p_hand_grip: Grip point in the palm's frame, (3,) [m].

    Returns:
        The inverse inertia.
    """
    links = range(pb.getNumJoints(robot, physicsClientId=client))
    joints = [i for i in links if pb.getJointInfo(robot, i, physicsClientId=client)[2] != pb.JOINT_FIXED]
    if not joints:
        return np.zeros((6, 6))
    q = [state[0] for state in pb.getJointStates(robot, joints, physicsClientId=client)]
    zeros = [0.0] * len(q)
    state = pb.getLinkState(robot, palm, physicsClientId=client)
    R_palm = rotation_matrix(state[5])
    # pybullet takes the point in the link's inertial frame.
    point = rotation_matrix(state[3]).T @ (p_hand_grip - np.array(state[2]))
    with quiet(1):  # it warns about axes of the URDF that are unit vectors in single precision only
        linear, angular = pb.calculateJacobian(robot, palm, point.tolist(), q, zeros, zeros, physicsClientId=client)
        M = np.array(pb.calculateMassMatrix(robot, q, physicsClientId=client))
    J = np.vstack([R_palm.T @ np.array(linear), R_palm.T @ np.array(angular)])
    return np.asarray(J @ np.linalg.solve(M, J.T))


TENDON_LOSS = 0.4  # fraction of the tilting torque that is lost while the fingers close again
TILT_SLIP = 0.015  # fraction of a tilt beyond the bound that remains as slip
RELEASE_SLIP = 0.030  # [m]
RELEASE_ANGLE = np.deg2rad(50.0)
RELEASE_TILT = np.deg2rad(50.0)

Motion = tuple[Vector, Vector]
"""Velocity of a body's centre of mass [m/s], and its angular velocity [rad/s]."""


@dataclass(frozen=True)
class GripLimits:
    """Bounds of the force and torque that the grip transmits.

    Attributes:
        along: Force along the handle, without a torque about it [N].
        across: Force across the handle [N].
        about: Torque about the handle, without a force along it [Nm].
        tilting: Torque that tilts the handle [Nm].
    """

    along: float
    across: float
    about: float
    tilting: float

    @classmethod
    def clamped(cls) -> GripLimits:
        """The bounds of a clamp that does not slip: none."""
        return cls(np.inf, np.inf, np.inf, np.inf)

    @classmethod
    def from_contact(cls, normal_force: float, friction: float, handle_radius: float, width: float) -> GripLimits:
        """The bounds for a grip by contact.

        Args:
            normal_force: Sum of the finger forces [N].
            friction: Coefficient of friction between hand and handle.
            handle_radius: Radius of the handle [m].
            width: Width of the hand along the handle, `HandModel.grip_width` [m].

        Returns:
            The bounds.
        """
        n = float(normal_force)  # numpy's scalars are slow
        return cls(friction * n, n, friction * n * handle_radius, (1 + friction) * n * width / 4)

    def bounded(self, force: Vector, about: float, handle: Vector) -> tuple[Vector, float]:
        """Limit force and torque about the handle to what the grip transmits.

        Args:
            force: Force, (3,) [N].
            about: Torque about the handle [Nm].
            handle: Unit vector along the handle, (3,).

        Returns:
            The limited ones; the same objects where nothing has to be limited.
        """
        along = _dot(force, handle)
        share_along, share_about = along / self.along, about / self.about
        squared = _dot(force, force) - along * along  # of the part across
        opens = squared > self.across * self.across
        # The cheap bound decides nearly always.
        if not opens and abs(share_along) + abs(share_about) < 1.0:
            return force, about
        used = math.hypot(share_along, share_about)
        if not opens and used <= 1.0:
            return force, about
        across = _plus(force, -along, handle)
        share = 1.0 / max(used, 1.0)
        kept = _times(self.across / math.sqrt(squared), across) if opens else across
        return _plus(kept, share * along, handle), share * about


class AssistedGrip:
    """The connection between tool and palm, at rest in their current relative pose.

    Args:
        client: pybullet's physics client.
        robot: pybullet's id of the robot.
        palm: Index of the palm's link.
        tool: pybullet's id of the tool, a free body.
        X_inertial_tool: Pose of the tool's frame in the body's inertial frame, 4x4; its z axis is the handle.
        p_hand_grip: Grip point in the palm's frame, (3,) [m].
        limits: Bounds of the force and torque that it transmits.
        time_step: The longest time step [s].

    Attributes:
        limits: Bounds of the force and torque that it transmits.
        holding: Whether it holds the tool; False once released.
        gains: Stiffness and damping.
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
        state = pb.getLinkState(robot, palm, physicsClientId=client)
        p, q = pb.getBasePositionAndOrientation(tool, physicsClientId=client)
        R_palm, R_tool = rotation_matrix(state[5]), rotation_matrix(q)
        R = R_palm.T @ R_tool
        anchor = R_tool.T @ (np.array(state[4]) + R_palm @ p_hand_grip - np.array(p))
        mobility = palm_mobility(client, robot, palm, p_hand_grip) + tool_mobility(client, tool, R, R @ anchor)
        self.gains = GripGains.stable(mobility, R @ X_inertial_tool[:3, 2], time_step)
        self._anchor, self._handle = anchor.tolist(), X_inertial_tool[:3, 2].tolist()  # in the tool's inertial frame
        self._p_rest: Vector = p_hand_grip.tolist()  # rest position of the anchor, palm frame
        self._q_rest = _product(_inverse(q), state[5])  # palm in the tool's inertial frame, at rest
        self._p_start, self._q_start = self._p_rest, self._q_rest
        self._tilt = self._bent = 0.0  # angle [rad] and torque [Nm] against it, of the last step

    @property
    def slip(self) -> float:
        """Accumulated slip of the handle in the hand [m]."""
        return math.dist(self._p_rest, self._p_start)

    @property
    def slip_angle(self) -> float:
        """Accumulated rotational slip of the handle in the hand [rad]."""
        turn = _rotation_vector(_product(self._q_start, _inverse(self._q_rest)))
        return math.sqrt(_dot(turn, turn))

    def before_step(self, dt: float) -> None:
        """Apply force and torque for the next step of dt [s]; release the tool when it has slipped too far."""
        if not self.holding:
            return
        state = pb.getLinkState(self._robot, self._palm, computeLinkVelocity=1, physicsClientId=self._client)
        com_palm, p_palm, q_palm, v_palm, w_palm = state[0], state[4], state[5], state[6], state[7]
        p, q = pb.getBasePositionAndOrientation(self._tool, physicsClientId=self._client)
        v_tool, w_tool = pb.getBaseVelocity(self._tool, physicsClientId=self._client)
        R_palm, R_tool = pb.getMatrixFromQuaternion(q_palm), pb.getMatrixFromQuaternion(q)
        arm, handle = turned(R_tool, self._anchor), turned(R_tool, self._handle)
        point = _plus(p, 1.0, arm)
        lever = _plus(point, -1.0, com_palm)
        v = _slip_rate((v_tool, w_tool), arm, (v_palm, w_palm), lever)
        u = _plus(_plus(point, -1.0, p_palm), -1.0, turned(R_palm, self._p_rest))
        gains = self.gains
        phi = _rotation_vector(_product(_product(q, self._q_rest), _inverse(q_palm)))
        w = _plus(w_tool, -1.0, w_palm)
        about, w_about = _dot(phi, handle), _dot(w, handle)
        spring, twist = _times(gains.stiffness, u), gains.about_stiffness * about
        elastic, elastic_twist = self.limits.bounded(spring, twist, handle)
        slips = elastic is not spring
        turn: Vector | None = None  # of the handle's rest pose
        if slips:
            moved = _plus(u, -1.0 / gains.stiffness, elastic)
            self._p_rest = _plus(self._p_rest, 1.0, turned(_transposed(R_palm), moved))
            turn = _times(about - elastic_twist / gains.about_stiffness, handle)
        force, torque_about = self.limits.bounded(
            _plus(_times(-1.0, elastic), -gains.damping, v), -elastic_twist - gains.about_damping * w_about, handle
        )
        bend, yielded = self._bend(_plus(phi, -about, handle), w, dt)
        tilting = _plus(_times(-1.0, bend), -gains.tilt_damping, _plus(w, -w_about, handle))
        torque = _plus(_shortened(tilting, self.limits.tilting), torque_about, handle)
        if yielded is not None:
            turn = yielded if turn is None else _plus(turn, 1.0, yielded)
        if turn is not None and (angle := math.sqrt(_dot(turn, turn))) > 1e-10:
            slips = True
            back = pb.getQuaternionFromAxisAngle(_times(-1.0 / angle, turned(_transposed(R_palm), turn)), angle)
            self._q_rest = _product(self._q_rest, back)

        if self._tilt > RELEASE_TILT or (slips and (self.slip > RELEASE_SLIP or self.slip_angle > RELEASE_ANGLE)):
            self.release()
            return
        self._apply(force, torque, point)

    def _bend(self, tilt: Vector, w: Vector, dt: float) -> tuple[Vector, Vector | None]:
        """Elastic part of the torque against a tilt; all vectors have the same axes.

        Args:
            tilt: Deflection across the handle, a rotation vector [rad].
            w: Angular velocity of the tool relative to the palm [rad/s].
            dt: Length of the step [s].

        Returns:
            Torque of the palm on the tool, reversed [Nm], and rotation of the tool's rest pose [rad], None for none.
        """
        limit, stiffness = self.limits.tilting, self.gains.tilt_stiffness
        angle = math.sqrt(_dot(tilt, tilt))
        spring = stiffness * angle
        bent = self._bent + stiffness * (angle - self._tilt)
        self._tilt = angle
        self._bent = min(max(bent, min(spring, (1.0 - TENDON_LOSS) * limit)), spring, limit)
        if spring <= (1.0 - TENDON_LOSS) * limit:
            return _times(stiffness, tilt), None
        torque = _times(self._bent / angle, tilt)
        if self._bent < limit:
            return torque, None
        growth = max(_dot(w, tilt) / angle, 0.0)
        return torque, _times(TILT_SLIP * growth * dt / angle, tilt)

    def _apply(self, force: Vector, torque: Vector, at: Vector) -> None:
        """Apply force and torque to the tool, and the reverse to the palm."""
        for body, link, sign in ((self._tool, -1, 1.0), (self._robot, self._palm, -1.0)):
            f, t = _times(sign, force), _times(sign, torque)
            pb.applyExternalForce(body, link, f, at, pb.WORLD_FRAME, physicsClientId=self._client)
            pb.applyExternalTorque(body, link, t, pb.WORLD_FRAME, physicsClientId=self._client)

    def release(self) -> None:
        """Release the tool permanently."""
        self.holding = False


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _times(share: float, a: Vector) -> Vector:
    return share * a[0], share * a[1], share * a[2]


def _plus(a: Vector, share: float, b: Vector) -> Vector:
    """The vector a + share * b."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


def _transposed(R: Vector) -> Vector:
    return R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]


def _slip_rate(tool: Motion, arm: Vector, palm: Motion, lever: Vector) -> Vector:
    """Velocity of a point of the tool relative to the palm's at the same place [m/s].

    Args:
        tool: Motion of the tool.
        arm: The point from the tool's centre of mass [m].
        palm: Motion of the palm.
        lever: The point from the palm's centre of mass [m].

    Returns:
        The velocity, axes of the world.
    """
    ((vx, vy, vz), (wx, wy, wz)), (ax, ay, az) = tool, arm
    ((ux, uy, uz), (ox, oy, oz)), (lx, ly, lz) = palm, lever
    return (
        vx + (wy * az - wz * ay) - ux - (oy * lz - oz * ly),
        vy + (wz * ax - wx * az) - uy - (oz * lx - ox * lz),
        vz + (wx * ay - wy * ax) - uz - (ox * ly - oy * lx),
    )


def _product(a: Vector, b: Vector) -> Vector:
    """Product of two quaternions (x, y, z, w)."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by + ay * bw + az * bx - ax * bz,
        aw * bz + az * bw + ax * by - ay * bx,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _inverse(q: Vector) -> Vector:
    """Inverse of a unit quaternion (x, y, z, w)."""
    return -q[0], -q[1], -q[2], q[3]


def _rotation_vector(q: Vector) -> Vector:
    """Axis times angle [rad] of a unit quaternion (x, y, z, w), the shorter way round."""
    sine = math.sqrt(_dot(q, q))
    w = q[3]
    if sine < 1e-9:
        return _times(math.copysign(2.0, w), q)
    return _times(2.0 * math.atan2(math.copysign(sine, w), abs(w)) / sine, q)


def _shortened(vector: Vector, most: float) -> Vector:
    """The vector (3,), no longer than this."""
    squared = _dot(vector, vector)
    return vector if squared <= most * most else _times(most / math.sqrt(squared), vector)
