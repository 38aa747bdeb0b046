"""Elasticity of the arm's joints: a spring between the motor's side of each gear and the link.

    command -> motor's side (position loop) -> gear: spring, damper, largest torque -> link

The motor's side follows the command as the joints of an exact arm do. Rotors are heavy at the gear's output (inertia
times the gear's ratio squared: some kg m^2), so that a strike of 5 ms does not move them; a load moves the link alone.
Beyond the joint's largest torque the motor's side yields, and its position loop brings it back.

The controller knows the masses of its links and the payload that it was told. It displaces the motor's side by the
deflection that gravity and the commanded motion cause by these (inverse dynamics): what is left is what the payload is
wrong by, and what nobody commands, such as a contact. Universal Robots publish that the controller computes these
torques (RTDE: target_moment) and that each joint has an encoder on either side of its gear (Madsen et al., 2020,
doi:10.1155/2020/8709870), not what becomes of the deflection: that it is compensated so is assumed.

Left out: dry friction of the gears. The position loop overcomes it on the motor's side, and the arm's readings are
those of the link's side, where its lost motion (an arc minute or less) is seen as any other motion is.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from toolee_robot.frames import Array
from toolee_robot.robots import RobotDescription, write_urdf
from toolee_robot.robots.tree import Tree
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
        self._torques = self.model.at(q, np.zeros(6), np.zeros(6))  # as the controller knows them, at this time
        self._rate, self._left = np.zeros(6), 0.0  # their change [Nm/s], and how long it lasts [s]
        self._wanted, self._span = self._torques, 0.0  # those at the last command; time between the last two [s]
        self._velocity = np.zeros(6)  # the last one commanded
        self._motor = (q + self._torques / self.stiffness).tolist()
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
        self._rate, self._left, self._span = (ahead - self._torques) / since, since, since

    def step(self, target: Array, velocity: Array, q: list[float], qd: list[float], dt: float) -> list[float]:
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
        if self._left > 0.0:
            share = min(dt, self._left)
            self._left -= dt
            self._torques = self._torques + share * self._rate
            velocity = velocity + share / dt * self._rate / self.stiffness
            if self._left <= 0.0 and self._span > 0.0:
                self._rate, self._left, self._span = (self._wanted - self._torques) / self._span, self._span, 0.0
        ends = (target + self._torques / self.stiffness).tolist()
        motor, torques = self._motor, []
        gain = MOTOR_GAIN * dt
        # Scalars: numpy takes several times as long for six numbers.
        rows = zip(self._gears, ends, velocity.tolist(), q, qd, strict=True)
        for i, ((stiffness, damping, largest), end, speed, position, rate) in enumerate(rows):
            bound = largest / stiffness
            start = min(max(motor[i], position - bound), position + bound)  # where it yields to
            ahead = start + speed * dt
            moved = ahead + gain * (end - ahead)
            torque = stiffness * (start - position) + damping * ((moved - start) / dt - rate)
            torques.append(min(max(torque, -largest), largest))
            motor[i] = moved
        return torques
