"""The robot in pybullet: joint motors with bounded torque, and a force sensor at the flange."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin

from toolee_robot.frames import Array
from toolee_robot.robots import RobotDescription, WristJoint, write_urdf
from toolee_robot.robots.tree import Tree, fuse_links
from toolee_robot.runtime.processes import interrupts_held
from toolee_robot.sim_backend.physics.bodies import pb, pose_matrix, quiet
from toolee_robot.types import Payload

STIFFNESS = (6.7e4, 6.7e4, 3.1e4, 1.0e4, 1.0e4, 1.0e4)
"""Stiffness of the gears, base to wrist 3 [Nm/rad].

Strain wave gears of sizes 32, 25 and 17 at low torque, whose repeated peak torques are near the UR10's 330, 150 and 56
Nm: K1 of Harmonic Drive's CSG and HFUS catalogues for ratios of 80 and more. That a UR has gears of these sizes is
assumed. At more torque they are stiffer, which is left out: after K1 = 6.7e4 Nm/rad, up to 29 Nm, comes K2 = 1.1e5 up
to 108 Nm (worked example in Harmonic Drive's CHA manual, 1018854, section 4.2)."""
DAMPING_RATIO = 0.07
"""Damping of each joint as a share of the critical one for the inertia about its axis at the start; assumed."""
STABILITY_NUMBER = 2.0
"""Bound of (h^2 k + 2 h d) / inertia for each joint by itself and the longest step h.

Steps are unstable where it reaches 4 for all joints and the grip together (`GripGains.stable`). The Shadow hand stays
below it; behind a light mount wrist 3 would ring faster than steps resolve, and is made softer."""
COUPLED_NUMBER = 2.6
"""Bound of the same for all six together. Nominal joints stay below it, far stiffer ones do not."""
IN_A_ROW = 0.02
"""Time between two commands [s] below which they are points of one motion: two cycles and a half at 125 Hz."""
MOTOR_GAIN = 100.0
"""Gain of the position loop on the motor's side [1/s]."""


class LinkTorques:
    """Inverse dynamics of the arm as its controller has them.

    Args:
        robot: Description of the arm; the hand counts as payload.
    """

    def __init__(self, robot: RobotDescription) -> None:
        arm = {robot.tree.links[0].name, *(robot.tree.carried_by(joint) for joint in robot.arm_joints)}
        links = [link for link in robot.tree.links if link.name in arm]
        self._model = pin.buildModelFromXML(write_urdf("arm", Tree(tuple(links))))
        self._data = self._model.createData()
        self._bare = self._model.inertias[6].copy()
        zero = np.zeros(len(robot.hand_joints))
        poses = robot.link_poses(np.zeros(6), zero)
        last = poses[robot.tree.carried_by(robot.arm_joints[5])]
        self._X_last_flange = np.linalg.inv(last) @ poses[robot.flange_frame]
        self.payload = robot.hand_payload(robot.hand_open)

    @property
    def payload(self) -> Payload:
        """What the flange is believed to carry, a point mass; centre of mass in the flange's frame [m]."""
        return self._payload

    @payload.setter
    def payload(self, payload: Payload) -> None:
        self._payload = payload
        X = self._X_last_flange
        at = X[:3, :3] @ payload.center_of_mass + X[:3, 3]
        self._model.inertias[6] = self._bare + pin.Inertia(payload.mass, at, np.zeros((3, 3)))

    def at(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Torques of the joints on the links, gravity included.

        Args:
            q: Joint positions, (6,) [rad].
            qd: Joint velocities, (6,) [rad/s].
            qdd: Joint accelerations, (6,) [rad/s^2].

        Returns:
            Torques, (6,) [Nm].
        """
        return np.asarray(pin.rnea(self._model, self._data, q, qd, qdd))


class JointSprings:
    """Torques of the six gears on the links, step by step.

    Args:
        size: Compliance as a share of the nominal one.
        largest: Largest torques of the joints, (6,) [Nm].
        inertias: Mass matrices of arm and hand, arm first, wrist included, at the start and in poses in which steps are
            to be stable, (n, 6 + m, 6 + m) [kg m^2].
        robot: Description of arm and hand.
        q: Joint positions at the start, at rest, (6,) [rad].
        time_step: The longest time step [s].

    Attributes:
        stiffness: Stiffness of each joint, (6,) [Nm/rad].
        damping: Damping of each joint, (6,) [Nm s/rad].
        model: What the controller knows of the arm.
    """

    def __init__(
        self, size: float, largest: Array, inertias: Array, robot: RobotDescription, q: Array, time_step: float
    ) -> None:
        stiffness = np.array(STIFFNESS) / size
        damping = 2.0 * DAMPING_RATIO * np.sqrt(stiffness * np.diag(inertias[0])[:6])
        mobilities = np.linalg.inv(inertias)[:, :6, :6]
        number = time_step**2 * stiffness + 2.0 * time_step * damping
        single = np.diagonal(mobilities, axis1=1, axis2=2).max(axis=0)
        scale = np.minimum(1.0, STABILITY_NUMBER / (number * single))
        scale *= min(1.0, COUPLED_NUMBER / float(np.linalg.eigvals(mobilities * (scale * number)).real.max()))
        self.stiffness, self.damping = scale * stiffness, scale * damping
        self.model = LinkTorques(robot)
        self._wanted, self._span = self.model.at(q, np.zeros(6), np.zeros(6)), 0.0  # torques at the last command, as
        # the controller knows them; time between the last two commands [s]
        self._torques = self._wanted.tolist()  # at this time
        self._rate, self._left = [0.0] * 6, 0.0  # their change [Nm/s], and how long it lasts [s]
        self._velocity = np.zeros(6)  # the last one commanded
        self._motor = (q + self._wanted / self.stiffness).tolist()
        self._largest = largest
        self._gears = list(zip(self.stiffness.tolist(), self.damping.tolist(), largest.tolist(), strict=True))

    @property
    def motor(self) -> Array:
        """Positions of the motors' sides, at the gears' outputs, (6,) [rad]."""
        return np.array(self._motor)

    @property
    def torques_commanded(self) -> Array:
        """Torques of the last command as the controller computes them, gravity included, (6,) [Nm]."""
        return self._wanted

    def command(self, q: Array, qd: Array, since: float) -> None:
        """Feed the commanded motion forward.

        Until the next command the torques change as they did since the last; where none comes, they return to those of
        this one.

        Args:
            q: Commanded joint positions, (6,) [rad].
            qd: Velocities at which they move on, (6,) [rad/s].
            since: Time since the last command [s].
        """
        if since <= 0.0:
            return
        before, self._velocity = self._velocity, qd
        # A joint that is blocked or jumps would ask for more than a motor has.
        wanted = np.clip(self.model.at(q, 0.5 * (before + qd), (qd - before) / since), -self._largest, self._largest)
        last, self._wanted = self._wanted, wanted
        ahead = 2.0 * wanted - last if since < IN_A_ROW else wanted
        self._rate, self._left, self._span = ((ahead - self._torques) / since).tolist(), since, since

    def step(
        self, target: Sequence[float], velocity: Sequence[float], q: list[float], qd: list[float], dt: float
    ) -> list[float]:
        """Advance the motors' sides by a step.

        Args:
            target: Commanded joint positions at the end of the step, (6,) [rad].
            velocity: Commanded joint velocities, (6,) [rad/s].
            q: Positions of the links, six [rad].
            qd: Their velocities, six [rad/s].
            dt: Length of the step [s].

        Returns:
            Torques on the links during the step, six [Nm].
        """
        # Scalars: numpy takes several times as long for six numbers.
        share = min(dt, self._left) if self._left > 0.0 else 0.0
        motor, known, torques = self._motor, self._torques, []
        gain = MOTOR_GAIN * dt
        rows = zip(self._gears, target, velocity, self._rate, q, qd, strict=True)
        for i, ((stiffness, damping, largest), place, speed, change, position, rate) in enumerate(rows):
            if share > 0.0:
                known[i] += share * change
                speed = speed + share / dt * change / stiffness
            end = place + known[i] / stiffness
            bound = largest / stiffness
            start = min(max(motor[i], position - bound), position + bound)  # where it yields to
            ahead = start + speed * dt
            moved = ahead + gain * (end - ahead)
            torque = stiffness * (start - position) + damping * ((moved - start) / dt - rate)
            torques.append(min(max(torque, -largest), largest))
            motor[i] = moved
        self._left -= dt
        if share > 0.0 and self._left <= 0.0 and self._span > 0.0:
            self._rate = ((self._wanted - known) / self._span).tolist()
            self._left, self._span = self._span, 0.0
        return torques


ARM_GAIN = 100.0  # [1/s] of the arm's position loop
FINGER_GAIN = 20.0  # [1/s]
WRIST_GAIN = 12.0  # [1/s]: a wrist that yielded in a strike returns without a second strike


class RobotBody:
    """Arm and hand as one pybullet body, fixed at the world's origin (`base`).

    Commands are targets, which `before_step` converts to motor settings of the next step. Between two commands of the
    arm its target moves at the commanded velocity.

    Fingers that nobody moves, at first and once they hold (`stiffen`), are rigid, and one link: their motors would take
    four fifths of a step's time. A command for other positions makes them move again; pybullet then has another body.

    Args:
        client: pybullet's physics client.
        robot: Description of arm and hand.
        q_arm: Initial joint positions of the arm, (6,) [rad].
        q_hand: Initial joint positions of the hand, (n,) [rad].
        compliance: Elasticity of the arm's joints as a share of the nominal one (`joint_springs`); 0 for joints that
            follow exactly.
        time_step: The longest time step [s].

    Attributes:
        robot: Description of arm and hand.
        body: pybullet's id of the body.
        link_index: pybullet's index of each link, by its name; rigid fingers have none of their own.
        palm: Index of the palm's link.
        sensor_link: Index of the hand's root link, whose joint is the force sensor.
        hand_effort: Largest torques of the hand's joints, (n,) [Nm].
        q_arm_target: Commanded joint positions of the arm, (6,) [rad].
        qd_arm_target: Commanded joint velocities of the arm, (6,) [rad/s].
        q_hand_target: Commanded joint positions of the hand, (n,) [rad].
    """

    def __init__(
        self,
        client: int,
        robot: RobotDescription,
        q_arm: Array,
        q_hand: Array,
        compliance: float = 0.0,
        time_step: float = 1e-3,
    ) -> None:
        self.robot = robot
        self._client = client
        self.hand_effort = robot.effort[6:].copy()
        self._hand_gain = np.full(len(robot.hand_joints), FINGER_GAIN)
        self._springs: dict[int, WristJoint] = {}
        for i, joint in enumerate(robot.hand.wrist):
            if joint.stiffness > 0.0:
                self._springs[i] = joint
            self.hand_effort[i] = min(self.hand_effort[i], joint.torque)
            self._hand_gain[i] = WRIST_GAIN
        self.q_arm_target, self.qd_arm_target = np.array(q_arm, dtype=float), np.zeros(6)
        self._course = self.q_arm_target.tolist(), self.qd_arm_target.tolist()
        self.q_hand_target = np.array(q_hand, dtype=float)
        self._since_command = 0.0
        self._ignored: list[tuple[int, int | None]] = []
        self._elastic: JointSprings | None = None
        self._load(self.q_arm_target, np.zeros(6), self.q_hand_target, np.zeros_like(self.q_hand_target), rigid=True)
        if compliance > 0.0:
            poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (150, 6))  # any that are spread out
            inertias = np.array([self.inertia(q) for q in (self.q_arm_target, *poses)])
            effort = np.array(self._arm_effort)
            self._elastic = JointSprings(compliance, effort, inertias, robot, self.q_arm_target, time_step)
            self._release_motors()

    def _reload(self, *, rigid: bool) -> None:
        """Replace the body by one that is in the same state."""
        (q_arm, qd_arm), (q_hand, qd_hand) = self.arm_state(), self.hand_state()
        with interrupts_held():  # whoever stops the arm needs a whole one
            pb.removeBody(self.body, physicsClientId=self._client)
            self._load(q_arm, qd_arm, q_hand, qd_hand, rigid=rigid)
            ignored, self._ignored = self._ignored, []
            for body, link in ignored:
                self.ignore_collisions(body, link)
            if self._elastic is not None:
                self._release_motors()

    def _release_motors(self) -> None:
        """Disable pybullet's motors of the arm: the springs alone move it."""
        pb.setJointMotorControlArray(
            self.body, self._arm, pb.VELOCITY_CONTROL, forces=[0.0] * 6, physicsClientId=self._client
        )

    def inertia(self, q_arm: Array) -> Array:
        """Mass matrix of the joints that move, the arm's first.

        Args:
            q_arm: Joint positions of the arm, (6,) [rad]; those of the hand are as they are.

        Returns:
            The matrix, (6 + m, 6 + m) [kg m^2].
        """
        q = [*q_arm.tolist(), *self._state(self._hand)[0].tolist()]
        with quiet(1):  # it warns about axes of the URDF that are unit vectors in single precision only
            return np.array(pb.calculateMassMatrix(self.body, q, physicsClientId=self._client))

    def _load(self, q_arm: Array, qd_arm: Array, q_hand: Array, qd_hand: Array, *, rigid: bool) -> None:
        """Make the body, with rigid fingers or with fingers that move."""
        robot, client = self.robot, self._client
        wrist = len(robot.hand.wrist)
        self._rigid = rigid
        fixed = dict(zip(robot.hand_joints[wrist:], q_hand[wrist:].tolist(), strict=True)) if rigid else {}
        self._q_rigid = q_hand.copy()
        moving = robot.hand_joints[:wrist] if rigid else robot.hand_joints
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "robot.urdf"
            fused = fuse_links(robot.tree.with_fixed(fixed), robot.finger_links if rigid else ())
            file.write_text(write_urdf("robot", fused.tree))
            flags = pb.URDF_USE_INERTIA_FROM_FILE
            self.body = int(pb.loadURDF(str(file), useFixedBase=True, flags=flags, physicsClientId=client))
        infos = [pb.getJointInfo(self.body, i, physicsClientId=client) for i in range(self._joint_count())]
        joint_index = {info[1].decode(): i for i, info in enumerate(infos)}
        self.link_index = {info[12].decode(): i for i, info in enumerate(infos)}
        self._arm = [joint_index[name] for name in robot.arm_joints]
        self._hand = [joint_index[name] for name in moving]  # those that move
        self._fixed_places = fused.places
        self.palm = self.link_index[robot.hand_frame]
        self.sensor_link = self.link_index[robot.hand.tree.links[0].name]  # the joint of the hand's mount
        self._arm_effort = robot.effort[:6].tolist()
        for link in range(-1, len(infos)):
            pb.changeDynamics(
                self.body, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, restitution=0.0,
                lateralFriction=0.8, maxJointVelocity=20.0, physicsClientId=client,
            )  # fmt: skip
        n = len(moving)
        states = zip([*self._arm, *self._hand], [*q_arm, *q_hand[:n]], [*qd_arm, *qd_hand[:n]], strict=True)
        for index, q, qd in states:
            pb.resetJointState(self.body, index, float(q), float(qd), physicsClientId=client)
        pb.enableJointForceTorqueSensor(self.body, self.sensor_link, True, physicsClientId=client)
        self._hand_set_for = 0.0

    def _joint_count(self) -> int:
        return int(pb.getNumJoints(self.body, physicsClientId=self._client))

    def command_arm(self, q: Array, qd: Array) -> None:
        """Command the arm.

        Args:
            q: Joint positions, (6,) [rad].
            qd: Joint velocities at which the target moves until the next command, (6,) [rad/s].
        """
        self.q_arm_target, self.qd_arm_target = np.array(q, dtype=float), np.array(qd, dtype=float)
        self._course = self.q_arm_target.tolist(), self.qd_arm_target.tolist()
        if self._elastic is not None:
            self._elastic.command(self.q_arm_target, self.qd_arm_target, self._since_command)
        self._since_command = 0.0

    @property
    def torques_commanded(self) -> Array | None:
        """Joint torques of the last command, see `JointSprings`, (6,) [Nm]; None where the joints are not elastic."""
        return None if self._elastic is None else self._elastic.torques_commanded

    def set_payload(self, payload: Payload) -> None:
        """Tell the arm's controller what the flange carries, by which it compensates the deflection of its joints."""
        if self._elastic is not None:
            self._elastic.model.payload = payload

    def command_hand(self, q: Array) -> None:
        """Command joint positions (n,) [rad] of the hand, which it holds with its limited torques."""
        self.q_hand_target = np.array(q, dtype=float)
        self._hand_set_for = 0.0
        wrist = len(self.robot.hand.wrist)
        if self._rigid and not np.allclose(self.q_hand_target[wrist:], self._q_rigid[wrist:], rtol=0.0, atol=1e-9):
            self._reload(rigid=False)

    def stiffen(self) -> None:
        """Make the fingers rigid where they are, until they are commanded to be elsewhere."""
        if not self._rigid:
            self._reload(rigid=True)
            wrist = len(self.robot.hand.wrist)
            self.q_hand_target[wrist:] = self._q_rigid[wrist:]

    def ignore_collisions(self, body: int, link: int | None = None) -> None:
        """Disable collisions with a body of one link.

        Args:
            body: pybullet's id of the body.
            link: The robot's link that does not collide with it; None for all.
        """
        self._ignored.append((body, link))
        for i in range(-1, self._joint_count()) if link is None else (link,):
            pb.setCollisionFilterPair(self.body, body, i, -1, 0, physicsClientId=self._client)

    def before_step(self, dt: float) -> None:
        """Set the motors for the next step of dt [s]."""
        self._since_command += dt
        # The target at the end of the step; the motor's velocity is gain * error + feed-forward.
        start, qd = self._course
        q = [a + b * self._since_command for a, b in zip(start, qd, strict=True)]
        if self._elastic is None:
            self._set(self._arm, q, qd, self._arm_effort, [ARM_GAIN * dt] * 6)
        else:
            states = pb.getJointStates(self.body, self._arm, physicsClientId=self._client)
            torques = self._elastic.step(q, qd, [s[0] for s in states], [s[1] for s in states], dt)
            pb.setJointMotorControlArray(
                self.body, self._arm, pb.TORQUE_CONTROL, forces=torques, physicsClientId=self._client
            )
        for i, joint in self._springs.items():
            position = pb.getJointState(self.body, self._hand[i], physicsClientId=self._client)[0]
            self.hand_effort[i] = joint.torque + joint.stiffness * abs(position - joint.rest)
        n = len(self._hand)
        if n and self._hand_set_for != dt:
            self._hand_setting = self.q_hand_target[:n].tolist(), (self._hand_gain[:n] * dt).tolist()
        if n and (self._springs or self._hand_set_for != dt):
            q_hand, gains = self._hand_setting
            self._set(self._hand, q_hand, [0.0] * n, self.hand_effort[:n].tolist(), gains)
        self._hand_set_for = dt

    def _set(self, joints: list[int], q: list[float], qd: list[float], effort: list[float], gains: list[float]) -> None:
        pb.setJointMotorControlArray(
            self.body,
            joints,
            pb.POSITION_CONTROL,
            targetPositions=q,
            targetVelocities=qd,
            forces=effort,
            positionGains=gains,
            velocityGains=[1.0] * len(joints),
            physicsClientId=self._client,
        )

    def arm_state(self) -> tuple[Array, Array]:
        """Measured joint positions and velocities of the arm, (6,) [rad, rad/s]."""
        return self._state(self._arm)

    def hand_state(self) -> tuple[Array, Array]:
        """Measured joint positions and velocities of the hand, (n,) [rad, rad/s]."""
        q, qd = self._state(self._hand)
        n = len(self._hand)
        return np.concatenate([q, self._q_rigid[n:]]), np.concatenate([qd, np.zeros(len(self._q_rigid) - n)])

    def _state(self, joints: list[int]) -> tuple[Array, Array]:
        states = pb.getJointStates(self.body, joints, physicsClientId=self._client) if joints else ()
        return np.array([s[0] for s in states]), np.array([s[1] for s in states])

    def link_pose(self, link: int) -> Array:
        """Pose X_base_link, 4x4, of the URDF frame of the link with this index."""
        state = pb.getLinkState(self.body, link, physicsClientId=self._client)
        return pose_matrix(state[4], state[5])

    def link_poses(self) -> dict[str, Array]:
        """Pose X_base_link, 4x4, of each link's URDF frame, by its name; the robot's root is not among them."""
        poses = {name: self.link_pose(index) for name, index in self.link_index.items()}
        placed = {name: poses[at] @ X for name, (at, X) in self._fixed_places.items()}
        return {name: pose for name, pose in (poses | placed).items() if name in self.robot.tree.by_name}

    def sensor_reaction(self) -> tuple[float, ...]:
        """Wrench of the arm on the hand in the last step, (6,) [N, Nm].

        Along the principal axes of the hand's root link, about its centre of mass.
        """
        reaction: tuple[float, ...] = pb.getJointState(self.body, self.sensor_link, physicsClientId=self._client)[2]
        return reaction

    def sensor_motion(self) -> tuple[Array, Array, Array, Array]:
        """Motion of the hand's root link in `base`.

        Returns:
            Pose, 4x4; position of the centre of mass, (3,) [m]; angular velocity, (3,) [rad/s]; velocity of the centre
            of mass, (3,) [m/s].
        """
        state = pb.getLinkState(self.body, self.sensor_link, computeLinkVelocity=1, physicsClientId=self._client)
        return pose_matrix(state[4], state[5]), np.array(state[0]), np.array(state[7]), np.array(state[6])
