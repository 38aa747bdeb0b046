"""A nail in wood in pybullet: strikes drive it against the wood's resistance, and bend it if they are off-axis.

The nail slides along its axis on a prismatic joint whose motor holds velocity 0 with a force limited to the wood's
resistance at the current depth: the solver's Coulomb friction, stable where an explicit force diverges. Two hinges at
the wood's surface hold with the shank's plastic moment: a lateral or eccentric strike beyond it bends the nail
permanently, and a bent nail resists more. A person may have set the nail with a lean: its hole then leans, too. A
nail counts as bent from a shift of its head of 3 mm or a lean of 10 deg on. The nail's mass of
20 g is more than a real nail's (about 2 g), since the solver needs the mass ratio.

The engine moves bodies by the velocity at the end of a step, so that a nail which resists in full from the first step
on would go v dt / 2 too short, whatever the nail. At rest it resists with half of the force: velocities are then those
in the middle of steps.

`before_step` must be called before every step, and steps must be those of `bullet.IMPACT` while a fast body is
near (`impact_near`). Nothing but strikes moves the nail.
"""

from __future__ import annotations

from enum import StrEnum
from math import cos, sin

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, transform
from toolee_robot.sim_backend.physics.bodies import pb
from toolee_robot.sim_backend.physics.wood import NailSpec, resistance

IMPACT_DISTANCE = 0.006  # [m] distance of a body from the nail's head below which steps must be short
HEAD_HEIGHT = 0.006  # [m] of the head's collision shape: pybullet's contacts with a 1 mm disc are off by up to 0.6 mm
LUMPED_MASS = 0.020  # [kg] during strikes
STUCK_MASS = 100.0  # [kg] between strikes
STOP_FORCE = 1e6  # [N] limit of the motor that holds the nail still
AT_REST = 1e-3  # [m/s]
BENT_LEAN = np.deg2rad(10.0)
BENT_SHIFT = 0.003  # [m]
HINGE_MASS, HINGE_INERTIA = 1e-3, 1e-7  # [kg], [kg m^2] of the hinges' otherwise massless links
HINGE_X, HINGE_Y, SLIDE = 0, 1, 2


class NailOutcome(StrEnum):
    """Outcome for a nail.

    Attributes:
        STANDING: It is not driven yet.
        FLUSH: Its head is down.
        BENT: It leans by 10 deg, or its head was pushed 3 mm aside, however deep it is now.
    """

    STANDING = "standing"
    FLUSH = "flush"
    BENT = "bent"


class Nail:
    """A nail in a pybullet world.

    Args:
        client: pybullet's physics client.
        X_world_nail: Pose of the head's top before the first strike, if the nail does not lean, 4x4, z into the wood.
        spec: Nail and wood; the defaults if None.
        wood: pybullet's id of the body into which the nail is driven, which does not collide with it; None if there is
            none.
        flush_protrusion: Largest protrusion at which the nail counts as flush [m].
        lean: Rotation vector's x and y with which nail and hole lean about the point where it enters the wood, axes of
            the nail that does not [rad].
        into_wood: Direction square to the wood's surface, into it, (3,); None for that of `X_world_nail`.

    Attributes:
        spec: Nail and wood.
        flush_protrusion: Largest protrusion at which the nail counts as flush [m].
        X_world_surface: Pose at which the nail enters the wood, 4x4, z along its hole.
        entry: Its position [m].
        body: pybullet's id of the nail.
    """

    def __init__(
        self,
        client: int,
        X_world_nail: Array,
        spec: NailSpec | None = None,
        wood: int | None = None,
        flush_protrusion: float = 0.001,
        lean: tuple[float, float] = (0.0, 0.0),
        into_wood: Array | None = None,
    ) -> None:
        self.spec = spec = spec or NailSpec()
        self.flush_protrusion = flush_protrusion
        self._client = client
        upright = X_world_nail @ transform(p=[0.0, 0.0, spec.protrusion])
        self.X_world_surface = upright @ transform(Rotation.from_rotvec([*lean, 0.0]))
        self.entry: list[float] = self.X_world_surface[:3, 3].tolist()
        self._into_wood = self.X_world_surface[:3, :3].T @ (upright[:3, 2] if into_wood is None else into_wood)
        self._largest_shift = self._largest_lean = 0.0
        self.body = self._create()
        if wood is not None:
            for link in range(-1, 3):
                pb.setCollisionFilterPair(self.body, wood, link, -1, 0, physicsClientId=client)
        self._set_for: tuple[float, float, bool, bool, float] | None = None
        self._struck = True
        self._held_for: float | None = None
        self._head_place: tuple[float, float, float] | None = None  # positions of the joints
        self._head_pose = np.eye(4)  # at these
        self.before_step(0.0)

    def _create(self) -> int:
        spec, client = self.spec, self._client
        shank = spec.protrusion - spec.head_thickness
        grey = [0.62, 0.62, 0.66, 1.0]
        head = pb.createCollisionShape(
            pb.GEOM_CYLINDER,
            radius=spec.head_diameter / 2,
            height=HEAD_HEIGHT,
            collisionFramePosition=[0, 0, -spec.protrusion + HEAD_HEIGHT / 2],
            physicsClientId=client,
        )
        visual = pb.createVisualShapeArray(
            shapeTypes=[pb.GEOM_CYLINDER, pb.GEOM_CYLINDER],
            radii=[spec.head_diameter / 2, spec.diameter / 2],
            lengths=[spec.head_thickness, shank],
            visualFramePositions=[[0, 0, -spec.protrusion + spec.head_thickness / 2], [0, 0, -shank / 2]],
            rgbaColors=[grey, grey],
            physicsClientId=client,
        )
        X = self.X_world_surface
        body = pb.createMultiBody(
            baseMass=0.0,
            basePosition=X[:3, 3],
            baseOrientation=Rotation.from_matrix(X[:3, :3]).as_quat(),
            linkMasses=[HINGE_MASS, HINGE_MASS, LUMPED_MASS],
            linkCollisionShapeIndices=[-1, -1, head],
            linkVisualShapeIndices=[-1, -1, visual],
            linkPositions=[[0, 0, 0]] * 3,
            linkOrientations=[[0, 0, 0, 1]] * 3,
            linkInertialFramePositions=[[0, 0, 0], [0, 0, 0], [0, 0, -spec.protrusion]],
            linkInertialFrameOrientations=[[0, 0, 0, 1]] * 3,
            linkParentIndices=[0, 1, 2],
            linkJointTypes=[pb.JOINT_REVOLUTE, pb.JOINT_REVOLUTE, pb.JOINT_PRISMATIC],
            linkJointAxis=[[1, 0, 0], [0, 1, 0], [0, 0, 1]],
            physicsClientId=client,
        )
        for link, inertia in ((HINGE_X, HINGE_INERTIA), (HINGE_Y, HINGE_INERTIA), (SLIDE, 10 * HINGE_INERTIA)):
            pb.changeDynamics(
                body,
                link,
                localInertiaDiagonal=[inertia] * 3,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                restitution=0.0,
                lateralFriction=0.4,
                physicsClientId=client,
            )
        return int(body)

    def _hold(self, joint: int, limit: float) -> None:
        pb.setJointMotorControl2(
            self.body, joint, pb.VELOCITY_CONTROL, targetVelocity=0.0, force=limit, physicsClientId=self._client
        )

    def before_step(self, dt: float, struck: bool = True) -> None:
        """Set the motors' limits for the next step: the wood's resistance at the current depth, the plastic moment.

        Must be called before each step, after the engine's step length is set, since pybullet stores a motor's limit as
        an impulse. A step that would end below the wood's surface is prevented.

        Args:
            dt: Length of the step [s].
            struck: Whether a strike is in progress. Otherwise the nail is held still and made heavy: with its small
                mass and a limited motor it would creep under a pressing hammer, since the solver's few iterations do
                not converge (45 N at 1/1000 s: 9 mm in half a second into wood that resists with 120 N).
        """
        if struck != self._struck:
            self._struck = struck
            self._set_mass(LUMPED_MASS if struck else STUCK_MASS)
        if not struck and self._held_for == dt:
            return
        self._held_for = None if struck else dt
        travel, speed = pb.getJointState(self.body, SLIDE, physicsClientId=self._client)[:2]
        protrusion, bend = self.spec.protrusion - travel, self.bend_angle
        fast = not struck or protrusion - max(speed, 0.0) * dt <= 0.0
        at_rest = abs(speed) < AT_REST
        if (protrusion, bend, fast, at_rest, dt) == self._set_for:
            return
        self._set_for = (protrusion, bend, fast, at_rest, dt)
        self._largest_shift, self._largest_lean = self.largest_shift, self.largest_lean
        force = resistance(self.spec, protrusion, bend) * (0.5 if at_rest else 1.0)
        self._hold(SLIDE, STOP_FORCE if fast else force)
        for hinge in (HINGE_X, HINGE_Y):
            self._hold(hinge, self.spec.plastic_moment if struck else STOP_FORCE)

    def _set_mass(self, mass: float) -> None:
        pb.changeDynamics(
            self.body,
            SLIDE,
            mass=mass,
            localInertiaDiagonal=[10 * HINGE_INERTIA * mass / LUMPED_MASS] * 3,
            physicsClientId=self._client,
        )

    def impact_near(self, body: int, link: int = -1) -> bool:
        """Whether a body is so close to the nail's head that steps must be those of `bullet.IMPACT`.

        Args:
            body: pybullet's id of the body.
            link: Index of its link; -1 for the base.

        Returns:
            Whether it is closer than IMPACT_DISTANCE.
        """
        near = pb.getClosestPoints(
            body, self.body, IMPACT_DISTANCE, linkIndexA=link, linkIndexB=SLIDE, physicsClientId=self._client
        )
        return len(near) > 0

    def _joint(self, joint: int) -> float:
        return float(pb.getJointState(self.body, joint, physicsClientId=self._client)[0])

    @property
    def protrusion(self) -> float:
        """Protrusion of the nail over the wood, along its axis [m]."""
        return self.spec.protrusion - self._joint(SLIDE)

    def _direction(self) -> tuple[float, float, float]:
        """Direction of the nail in `X_world_surface`, a unit vector into the wood: Rx(a) Ry(b) z."""
        a, b = self._joint(HINGE_X), self._joint(HINGE_Y)
        return float(np.sin(b)), float(-np.sin(a) * np.cos(b)), float(np.cos(a) * np.cos(b))

    @property
    def bend_angle(self) -> float:
        """Angle between the nail and its hole [rad]."""
        x, y, z = self._direction()
        return float(np.arctan2(np.hypot(x, y), z))

    @property
    def lean_angle(self) -> float:
        """Angle between the nail and the normal of the wood's surface [rad]."""
        direction = np.array(self._direction())
        across = direction - (direction @ self._into_wood) * self._into_wood
        return float(np.arctan2(np.linalg.norm(across), direction @ self._into_wood))

    @property
    def shift(self) -> float:
        """Distance of the head from the axis of the nail's hole [m]."""
        x, y, _ = self._direction()
        return float(self.protrusion * np.hypot(x, y))

    @property
    def largest_shift(self) -> float:
        """Largest `shift` at any step so far [m]: the deeper the nail, the closer a bent one's head is to the axis."""
        return max(self._largest_shift, self.shift)

    @property
    def largest_lean(self) -> float:
        """Largest `lean_angle` at any step so far [rad]."""
        return max(self._largest_lean, self.lean_angle)

    @property
    def bent(self) -> bool:
        """Whether the nail counts as bent: its lean or its head's shift was too large at some step."""
        return self.largest_shift >= BENT_SHIFT or self.largest_lean >= BENT_LEAN

    def place(self, protrusion: float, bend: tuple[float, float] = (0.0, 0.0)) -> None:
        """Set the nail as if strikes had driven it so far and bent it so.

        Args:
            protrusion: Protrusion over the wood, along its axis [m].
            bend: Angles of the two hinges at the wood's surface, about x and y of `X_world_surface` [rad].
        """
        for joint, value in ((HINGE_X, bend[0]), (HINGE_Y, bend[1]), (SLIDE, self.spec.protrusion - protrusion)):
            pb.resetJointState(self.body, joint, value, physicsClientId=self._client)

    def head_pose(self) -> Array:
        """Current pose of the head's top, X_world_nail, 4x4."""
        # Called at every step of a strike, so written out: Rx(a) Ry(b), then up along the nail.
        states = pb.getJointStates(self.body, (HINGE_X, HINGE_Y, SLIDE), physicsClientId=self._client)
        place = a, b, travel = states[HINGE_X][0], states[HINGE_Y][0], states[SLIDE][0]
        if place == self._head_place:  # nothing but strikes moves the nail
            return self._head_pose.copy()
        self._head_place = place
        sa, ca, sb, cb, up = sin(a), cos(a), sin(b), cos(b), travel - self.spec.protrusion
        z = (sb, -sa * cb, ca * cb)
        X = np.array(
            [
                [cb, 0.0, z[0], z[0] * up],
                [sa * sb, ca, z[1], z[1] * up],
                [-ca * sb, sa, z[2], z[2] * up],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
        self._head_pose = self.X_world_surface.dot(X)
        return self._head_pose.copy()

    @property
    def outcome(self) -> NailOutcome:
        """The nail's current outcome."""
        if self.bent:
            return NailOutcome.BENT
        return NailOutcome.FLUSH if self.protrusion <= self.flush_protrusion else NailOutcome.STANDING
