"""The held strike in pybullet, with the station's nail, grip and step lengths."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pybullet as pb

from tests.cross_checks.held_hammer import (
    CARRIAGE_MASS,
    DURATION,
    FACE_DROP,
    GAP,
    LIFT,
    PALM_INERTIA,
    PALM_MASS,
    SWING,
    WRIST_GAIN,
    WRIST_TO_GRIP,
    HeldStrike,
    Rig,
)  # fmt: skip
from tests.sim_backend.physics.test_nail import FACE_RADIUS
from toolee_robot.frames import Array, transform
from toolee_robot.sim_backend.physics.bodies import IMPACT, StepSettings, rotation_matrix
from toolee_robot.sim_backend.physics.grip import AssistedGrip
from toolee_robot.sim_backend.physics.nail import Nail
from toolee_robot.sim_backend.world import NORMAL

CARRIAGE, WRIST = 0, 1
UPRIGHT = np.diag([1.0, -1.0, -1.0])
HANDLE = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Axes of the tool in the world at the start: its z along x."""
HEAD_LENGTH = 0.05
IMPACT_WINDOW = 0.015  # [s] after the contact in which steps are short; the station's is 10 ms after the last approach
REST = 0.05  # [s] over the nail
CARRIAGE_FORCE = 1e5  # [N] limit of its motor


class HeldInPybullet:
    """The rig in pybullet."""

    def __init__(self, client: int, rig: Rig, finer: int = 1) -> None:
        self._client, self._rig, self._finer = client, rig, finer
        self.nail = Nail(client, transform(UPRIGHT, [0.0, 0.0, rig.spec.protrusion]), rig.spec)
        height = rig.spec.protrusion + GAP + FACE_DROP
        hammer = rig.hammer
        grip_x = -hammer.reach - rig.eccentricity
        self.palm = pb.createMultiBody(
            0.0, basePosition=[grip_x - WRIST_TO_GRIP, rig.sideways, height], linkMasses=[CARRIAGE_MASS, PALM_MASS],
            linkCollisionShapeIndices=[-1, -1], linkVisualShapeIndices=[-1, -1], linkPositions=[[0, 0, 0]] * 2,
            linkOrientations=[[0, 0, 0, 1]] * 2, linkInertialFramePositions=[[0, 0, 0], [WRIST_TO_GRIP, 0, 0]],
            linkInertialFrameOrientations=[[0, 0, 0, 1]] * 2, linkParentIndices=[0, 1],
            linkJointTypes=[pb.JOINT_PRISMATIC, pb.JOINT_REVOLUTE], linkJointAxis=[[0, 0, -1], [0, 1, 0]],
            physicsClientId=client,
        )  # fmt: skip
        for link in (CARRIAGE, WRIST):
            pb.changeDynamics(self.palm, link, localInertiaDiagonal=[PALM_INERTIA] * 3, linearDamping=0.0,
                              angularDamping=0.0, jointDamping=0.0, physicsClientId=client)  # fmt: skip
        shape = pb.createCollisionShape(
            pb.GEOM_CYLINDER, radius=FACE_RADIUS, height=HEAD_LENGTH, physicsClientId=client,
            collisionFramePosition=[hammer.reach - hammer.balance, 0, HEAD_LENGTH / 2 - FACE_DROP],
        )  # fmt: skip
        self.tool = pb.createMultiBody(
            hammer.mass, shape, -1, [grip_x + hammer.balance, rig.sideways, height], physicsClientId=client
        )
        pb.changeDynamics(self.tool, -1, localInertiaDiagonal=list(hammer.moments), linearDamping=0.0,
                          angularDamping=0.0, restitution=0.0, lateralFriction=0.5, physicsClientId=client)  # fmt: skip
        pb.setGravity(0, 0, -9.81, physicsClientId=client)
        # The palm's frame is at its centre of mass, the grip's point.
        pb.resetJointState(self.palm, CARRIAGE, 0.0, rig.speed, physicsClientId=client)
        pb.resetBaseVelocity(self.tool, [0, 0, -rig.speed], [0, 0, 0], physicsClientId=client)
        X_inertial_tool = transform(HANDLE, [-hammer.balance, 0.0, 0.0])
        self.grip = AssistedGrip(
            client, self.palm, WRIST, self.tool, X_inertial_tool, np.array([WRIST_TO_GRIP, 0.0, 0.0]), rig.limits,
            NORMAL.time_step,
        )  # fmt: skip
        self.tilt = self.rebound = self.yielded = 0.0
        self.finite = True

    def _in_hand(self) -> tuple[Array, Array]:
        """Grip point of the handle in the palm, (3,) [m], and the tool's axes there, (3, 3)."""
        state = pb.getLinkState(self.palm, WRIST, physicsClientId=self._client)
        p, q = pb.getBasePositionAndOrientation(self.tool, physicsClientId=self._client)
        R_palm, R_tool = rotation_matrix(state[5]), rotation_matrix(q)
        point = np.array(p) + R_tool @ [-self._rig.hammer.balance, 0.0, 0.0]
        return R_palm.T @ (point - np.array(state[4])), R_palm.T @ R_tool

    def _face_speed(self) -> float:
        """Upward speed of the face's centre [m/s]."""
        v, w = (np.array(x) for x in pb.getBaseVelocity(self.tool, physicsClientId=self._client))
        q = pb.getBasePositionAndOrientation(self.tool, physicsClientId=self._client)[1]
        hammer = self._rig.hammer
        return float((v + np.cross(w, rotation_matrix(q) @ [hammer.reach - hammer.balance, 0.0, -FACE_DROP]))[2])

    def strike(self) -> HeldStrike:
        """Strike the nail once, from `GAP` over its head."""
        before = self.nail.protrusion
        start, angle = self._slipped(), self.grip.slip_angle
        self.tilt = self.rebound = self.yielded = 0.0
        near = GAP / self._rig.speed + IMPACT_WINDOW
        self._run(self._rig.carriage_speed, 0.0, near, IMPACT)
        self._run(self._rig.carriage_speed, near, DURATION, NORMAL)
        slip = self._slipped() - start
        left = float(np.arccos(np.clip(self._in_hand()[1][0, 0], -1.0, 1.0)))
        return HeldStrike(
            before - self.nail.protrusion, float(slip[0]), float(slip[2]), self.tilt, left, self.rebound, self.yielded,
            self.grip.slip_angle - angle, not self.grip.holding, self.finite,
        )  # fmt: skip

    def swing_again(self) -> None:
        """Lift the hammer and swing it down to `GAP` over the nail's head, at the strike's speed."""
        speed = self._rig.speed
        depth = float(pb.getJointState(self.palm, CARRIAGE, physicsClientId=self._client)[0])
        length = speed**2 / (2 * SWING)
        lift = depth - (self._rig.spec.protrusion - self.nail.protrusion) + length
        top = LIFT / SWING
        cruise = max(0.0, lift / LIFT - top)
        ramp = min(top, float(np.sqrt(lift / SWING)))

        def profile(time: float) -> float:
            if time < 2 * ramp + cruise:
                return -SWING * min(ramp, time, 2 * ramp + cruise - time)
            return SWING * max(0.0, time - 2 * ramp - cruise - REST)

        self._run(profile, 0.0, 2 * ramp + cruise + REST + speed / SWING, NORMAL)

    def _slipped(self) -> Array:
        """Where the spring of the grip is at rest, palm's axes, (3,) [m]: it moves by slip alone."""
        return self._in_hand()[0] + self.grip.force / self.grip.gains.stiffness

    def _run(self, profile: Callable[[float], float], begin: float, end: float, settings: StepSettings) -> None:
        """Move the carriage by a profile of its speed [m/s] over time [s]; nothing happens once the hammer is lost."""
        rig, client, dt = self._rig, self._client, settings.time_step / self._finer
        StepSettings(dt, settings.iterations, settings.contact_erp).apply(client)
        for i in range(round((end - begin) / dt)):
            if not self.grip.holding or not self.finite:
                return
            q_wrist = pb.getJointState(self.palm, WRIST, physicsClientId=client)[0]
            pb.setJointMotorControl2(self.palm, CARRIAGE, pb.VELOCITY_CONTROL, targetVelocity=profile(begin + i * dt),
                                     force=CARRIAGE_FORCE, physicsClientId=client)  # fmt: skip
            pb.setJointMotorControl2(self.palm, WRIST, pb.VELOCITY_CONTROL, targetVelocity=-WRIST_GAIN * q_wrist,
                                     force=rig.wrist_torque, physicsClientId=client)  # fmt: skip
            self.nail.before_step(dt, struck=settings is IMPACT)
            self.grip.before_step(dt)
            pb.stepSimulation(physicsClientId=client)
            self.tilt = max(self.tilt, float(np.arccos(np.clip(self._in_hand()[1][0, 0], -1.0, 1.0))))
            self.rebound, self.yielded = max(self.rebound, self._face_speed()), max(self.yielded, abs(q_wrist))
            self.finite = self.finite and bool(np.isfinite(self.grip.force).all())


@contextmanager
def held_in_pybullet(rig: Rig, finer: int = 1) -> Iterator[HeldInPybullet]:
    """The rig in a pybullet world of its own."""
    client = pb.connect(pb.DIRECT)
    try:
        yield HeldInPybullet(client, rig, finer)
    finally:
        pb.disconnect(client)
