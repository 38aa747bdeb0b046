"""The robot in pybullet: joint motors with bounded torque, and a force sensor at the flange."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.robots import RobotDescription, WristJoint, write_urdf
from toolee_robot.robots.tree import fuse_links
from toolee_robot.runtime.processes import interrupts_held
from toolee_robot.sim_backend.physics.bodies import pb, pose_matrix, quiet
from toolee_robot.sim_backend.physics.joint_springs import JointSprings
from toolee_robot.types import Payload

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
        q = self.q_arm_target + self.qd_arm_target * self._since_command
        if self._elastic is None:
            self._set(self._arm, q, self.qd_arm_target, self._arm_effort, np.full(6, ARM_GAIN * dt))
        else:
            states = pb.getJointStates(self.body, self._arm, physicsClientId=self._client)
            torques = self._elastic.step(q, self.qd_arm_target, [s[0] for s in states], [s[1] for s in states], dt)
            pb.setJointMotorControlArray(
                self.body, self._arm, pb.TORQUE_CONTROL, forces=torques, physicsClientId=self._client
            )
        for i, joint in self._springs.items():
            position = pb.getJointState(self.body, self._hand[i], physicsClientId=self._client)[0]
            self.hand_effort[i] = joint.torque + joint.stiffness * abs(position - joint.rest)
        if self._hand and (self._springs or self._hand_set_for != dt):
            self._hand_set_for = dt
            n = len(self._hand)
            effort = self.hand_effort[:n].tolist()
            self._set(self._hand, self.q_hand_target[:n], np.zeros(n), effort, self._hand_gain[:n] * dt)

    def _set(self, joints: list[int], q: Array, qd: Array, effort: list[float], gains: Array) -> None:
        pb.setJointMotorControlArray(
            self.body,
            joints,
            pb.POSITION_CONTROL,
            targetPositions=q.tolist(),
            targetVelocities=qd.tolist(),
            forces=effort,
            positionGains=gains.tolist(),
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

    def sensor_reaction(self) -> Array:
        """Wrench of the arm on the hand in the last step, (6,) [N, Nm].

        Along the principal axes of the hand's root link, about its centre of mass.
        """
        return np.array(pb.getJointState(self.body, self.sensor_link, physicsClientId=self._client)[2])

    def sensor_motion(self) -> tuple[Array, Array, Array, Array]:
        """Motion of the hand's root link in `base`.

        Returns:
            Pose, 4x4; position of the centre of mass, (3,) [m]; angular velocity, (3,) [rad/s]; velocity of the centre
            of mass, (3,) [m/s].
        """
        state = pb.getLinkState(self.body, self.sensor_link, computeLinkVelocity=1, physicsClientId=self._client)
        return pose_matrix(state[4], state[5]), np.array(state[0]), np.array(state[7]), np.array(state[6])
