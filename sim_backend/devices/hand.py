"""The simulated hand: closes until contact, then holds with the assisted grip."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from toolee_robot.errors import DeviceError, StaleDataError
from toolee_robot.frames import Array, inverse
from toolee_robot.hal import HandState
from toolee_robot.robots import PALM
from toolee_robot.robots.tree import FUSED
from toolee_robot.sim_backend.physics.bodies import pb
from toolee_robot.sim_backend.physics.grip import AssistedGrip, GripLimits
from toolee_robot.sim_backend.world import NORMAL, SimWorld
from toolee_robot.types import JointState

TICK = 0.01  # [s]
ROOM_TEMPERATURE = 24.0  # [deg C]
CLOSING_SPEED = 4.0  # [rad/s] of the targets
LEAD = 0.25  # [rad] largest lead of a target over a blocked joint: enough for full torque
STILL = 0.05  # [rad/s] below which a joint counts as standing
STILL_TIME = 0.05  # [s] of standstill after which a joint counts as blocked
PHASE_TIME = 0.8  # [s] longest time for one group of joints; a joint that still moves goes on during the next group
CONTACT_FORCE = 0.3  # [N] above which a finger counts as touching
COURSE = 4096  # positions that are kept: a minute
AVERAGE_TIME = 0.06  # [s] over which the finger forces are averaged before the grip begins


class SimHand:
    """A `hal.Hand` that moves the simulated hand. The wrist holds its rest pose with its limited torque.

    Faults can be injected with `cut_link`, `hangs`, `temperature` and `fault`; `recover` undoes them all.

    Args:
        world: The simulated world.
        friction: Coefficient of friction between hand and handle.

    Attributes:
        temperature: Reported temperature [deg C].
        fault: Reported fault; empty for none.
        hangs: Fault: whether motions time out.
    """

    def __init__(self, world: SimWorld, friction: float) -> None:
        self._world = world
        self._friction = friction
        self._robot = world.robot.robot
        self._model = self._robot.hand
        self._target = world.robot.q_hand_target.copy()
        self._holding_forces: dict[str, float] | None = None
        self._open_device = True
        self.temperature, self.fault = ROOM_TEMPERATURE, ""
        self.hangs = False
        self._last: HandState | None = None  # the last state received, while the link is down
        self._course: deque[tuple[float, Array]] = deque(maxlen=COURSE)
        world.observers.append(lambda sample: self._course.append((sample.stamp, sample.q_hand)))

    def __enter__(self) -> Self:
        self._open_device = True
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._open_device = False

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the hand's joints, wrist first."""
        return self._robot.hand_joints

    @property
    def gripped(self) -> bool:
        """Whether the assisted grip holds the tool: the fingers then keep their places."""
        return self._world.grip is not None and self._world.grip.holding

    def state(self, max_age: float = 0.1) -> HandState:
        """The current state.

        Args:
            max_age: Largest accepted age [s].

        Returns:
            The state; the last one received while the link is down.

        Raises:
            StaleDataError: The link has been down for longer than `max_age`.
            DeviceError: The hand is closed.
        """
        self._check_open()
        if self._last is None:
            return self._read()
        age = self._world.time - self._last.joints.stamp
        if age > max_age:
            message = f"the hand's newest state is {age:.2f} s old: check its cable, then start again"
            raise StaleDataError(message, code="stale_data.hand")
        return self._last

    def course(self, since: float) -> Sequence[tuple[float, Array]]:
        """The joints' positions every 16 ms, since a time [s]; see `hal.KeepsCourse`."""
        return [(stamp, q) for stamp, q in self._course if stamp >= since]

    def cut_link(self) -> None:
        """Fault: the hand's states do not arrive, as with an unplugged cable; it keeps its grip."""
        self._last = self._read()

    def restore_link(self) -> None:
        """Undo `cut_link`."""
        self._last = None

    def recover(self) -> None:
        """Undo all injected faults."""
        self.restore_link()
        self.hangs = False
        self.temperature, self.fault = ROOM_TEMPERATURE, ""

    def _read(self) -> HandState:
        q, qd = self._world.robot.hand_state()
        assisted = self.gripped
        if assisted and self._holding_forces is not None:
            forces, holding = dict(self._holding_forces), True
        else:
            forces, links = self._contact_forces()
            assisted, holding = False, self._touches_enough(forces, links)
        joints = JointState(q, qd, self._world.time)
        return HandState(joints, forces, holding, assisted, self.temperature, self.fault)

    def open(self, timeout: float = 5.0) -> None:
        """Release the tool and spread the fingers.

        Args:
            timeout: Longest duration of each group of joints [s].

        Raises:
            DeviceError: The motion timed out, or the hand is closed.
        """
        self._check_open()
        self._check_moves(timeout)
        if self._world.grip is not None:
            self._world.grip.release()
        self._holding_forces = None
        goal = self._robot.hand_open
        for joints in reversed(self._model.closing_order):
            self._move(joints, goal, timeout)

    def close(self, timeout: float = 5.0) -> None:
        """Close until the fingers hold or are shut. If thumb and fingers hold the tool, the assisted grip begins.

        Args:
            timeout: Longest duration in all [s].

        Raises:
            DeviceError: The motion timed out, or the hand is closed.
        """
        self._check_open()
        self._check_moves(timeout)
        if self.gripped:
            return
        goal = self._robot.hand_closed
        end = self._world.time + timeout
        for joints in self._model.closing_order:
            self._move(joints, goal, end - self._world.time)
        self._hold()

    def stop(self) -> None:
        """Stop the fingers; a grip is kept."""
        if self._open_device and self._world.grip is None:
            q = self._world.robot.hand_state()[0]
            # The lead of each target is kept, so that a finger that presses keeps its force.
            ahead = np.clip(self._target - q, -LEAD, LEAD)
            self._target = q + ahead
            self._world.robot.command_hand(self._target)

    def _check_open(self) -> None:
        if not self._open_device:
            raise DeviceError("the hand is closed: use it inside its `with` block", code="device.closed")

    def _check_moves(self, timeout: float) -> None:
        if self.hangs:
            self._world.advance(timeout)
            message = f"the hand did not move within {timeout:.1f} s; it keeps its position and its grip"
            raise DeviceError(message, code="device.timeout")

    def _move(self, joints: tuple[str, ...], goal: np.ndarray, timeout: float) -> None:
        """Move some joints to their goals or until they are blocked; raises DeviceError on time-out."""
        index = np.array(self._model.index(joints))
        began = self._world.time
        end = began + timeout
        still = 0.0
        while True:
            q, qd = self._world.robot.hand_state()
            arrived = np.abs(goal[index] - q[index]) < 0.03
            if np.all(arrived | (np.abs(qd[index]) < STILL)):
                still += TICK
            else:
                still = 0.0
            if np.all(arrived) or still >= STILL_TIME or self._world.time >= began + PHASE_TIME:
                return
            if self._world.time >= end:
                message = "the hand did not finish its motion in time; it keeps its position and its grip"
                raise DeviceError(message, code="device.timeout")
            step = np.clip(goal[index] - self._target[index], -CLOSING_SPEED * TICK, CLOSING_SPEED * TICK)
            self._target[index] = q[index] + np.clip(self._target[index] + step - q[index], -LEAD, LEAD)
            self._world.robot.command_hand(self._target)
            self._world.advance(TICK)

    def _contact_forces(self) -> tuple[dict[str, float], set[str]]:
        """Normal forces [N] between hand and tool, by finger and "palm", and the links in contact."""
        forces = self._no_forces()
        links: set[str] = set()
        world = self._world
        names = {index: name for name, index in world.robot.link_index.items()}
        for contact in pb.getContactPoints(bodyA=world.robot.body, bodyB=world.tool.body, physicsClientId=world.client):
            name = names.get(contact[3], "").removesuffix(FUSED)  # rigid fingers belong to what carries them
            if name in self._model.tree.by_name and contact[9] > 0:
                forces[self._model.part_of(name)] += float(contact[9])
                if contact[9] > CONTACT_FORCE:
                    links.add(name)
        return forces, links

    def _no_forces(self) -> dict[str, float]:
        return dict.fromkeys((*(finger.name for finger in self._model.fingers), PALM), 0.0)

    def _touches_enough(self, forces: dict[str, float], links: set[str]) -> bool:
        opposing = self._model.opposing.name
        others = [link for link in links if self._model.part_of(link) not in (opposing, PALM)]
        return forces[opposing] > CONTACT_FORCE and len(others) >= self._model.holding_links

    def _hold(self) -> None:
        """Begin the assisted grip if thumb and fingers hold the tool by real contact."""
        if self.gripped:
            return
        world = self._world
        total = self._no_forces()
        links: set[str] = set()
        n = round(AVERAGE_TIME / TICK)
        for _ in range(n):
            world.advance(TICK)
            forces, touching = self._contact_forces()
            links |= touching
            for name, force in forces.items():
                total[name] += force / n
        if not self._touches_enough(total, links):
            return
        total = {name: min(force, self._model.finger_force) for name, force in total.items()}
        self._holding_forces = total
        fingers = sum(force for name, force in total.items() if name != PALM) + (world.config.hand.strap_force or 0.0)
        X_hand_tool = inverse(world.X_base_hand()) @ world.X_base_tool()
        # The grip's centre: the point of the handle's axis next to the palm's middle.
        along = (self._model.grasp.p[0] - X_hand_tool[0, 3]) / X_hand_tool[0, 2]
        z = float(np.clip(along, world.tool.tool.handle.z_min + 0.02, world.tool.tool.handle.z_max - 0.02))
        p_hand_grip = X_hand_tool[:3, 3] + z * X_hand_tool[:3, 2]
        radius = float(np.mean(world.tool.tool.handle.radii_at(z)))
        world.robot.ignore_collisions(world.tool.body)
        # Loads now pass through the palm; the fingers only keep their positions.
        world.robot.stiffen()
        self._target = world.robot.hand_state()[0]
        wrist = self._model.wrist_index
        self._target[wrist] = self._robot.hand_closed[wrist]
        world.robot.command_hand(self._target)
        world.grip = AssistedGrip(
            world.client,
            world.robot.body,
            world.robot.palm,
            world.tool.body,
            inverse(world.tool.X_tool_inertial),
            p_hand_grip,
            GripLimits.from_contact(fingers, self._friction, radius, self._model.grip_width),
            NORMAL.time_step,
        )


@dataclass(frozen=True)
class Touched:
    """What the simulated fingers feel.

    Attributes:
        fingers: Names of the fingers that touch the tool.
        gripped: Whether the assisted grip holds the tool.
    """

    fingers: tuple[str, ...]
    gripped: bool


class CoupledFingers(SimHand):
    """The simulated hand, moved to where an emulated hand's motors are."""

    def follow(self, q: Array) -> Touched:
        """Let the fingers go on towards the emulated hand's.

        Args:
            q: Positions of the emulated hand's joints, in the order of the model's [rad].

        Returns:
            What they feel now.
        """
        if not self.gripped:  # a grip carries the load through the palm, and the fingers keep their places
            now = self._world.robot.hand_state()[0]
            self._target = now + np.clip(q - now, -LEAD, LEAD)
            self._world.robot.command_hand(self._target)
        forces, _ = self._contact_forces()
        touching = (name for name, force in forces.items() if force > CONTACT_FORCE)
        return Touched(tuple(touching), self.gripped)

    def grip(self) -> bool:
        """Begin the assisted grip, if thumb and fingers hold the tool by real contact; takes some time.

        Returns:
            Whether it holds.
        """
        self._hold()
        return self.gripped

    def let_go(self) -> None:
        """End the assisted grip."""
        if self._world.grip is not None:
            self._world.grip.release()
        self._holding_forces = None


class SimMount:
    """A `hal.Hand` that is a tool mount: what a person has fixed in it stays where it was fixed.

    Like a real one it measures nothing: its hinge is reported at rest, also while it yields, and it holds what it was
    last told that it holds.

    Args:
        world: The simulated world, with a tool mount on the flange.
    """

    def __init__(self, world: SimWorld) -> None:
        self._world = world
        self._robot = world.robot.robot
        self._open_device = True
        # The clamp lies around the handle, which touches nothing else of the arm.
        world.robot.ignore_collisions(world.tool.body)

    def __enter__(self) -> Self:
        self._open_device = True
        return self

    def __exit__(self, *_: object) -> None:
        self._open_device = False

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The name of the hinge."""
        return self._robot.hand_joints

    def state(self, max_age: float = 0.1) -> HandState:  # noqa: ARG002
        """The state as far as it is known.

        Args:
            max_age: Ignored: nothing is measured.

        Returns:
            The hinge at rest, and whether a person was last said to have fixed a tool.

        Raises:
            DeviceError: The mount is closed.
        """
        self._check_open()
        rest = self._robot.hand_open
        return HandState(JointState(rest, np.zeros_like(rest), self._world.time), {}, self._world.grip is not None)

    def open(self, timeout: float = 5.0) -> None:  # noqa: ARG002
        """Let the person who holds the tool take it out.

        Args:
            timeout: Ignored.

        Raises:
            DeviceError: The mount is closed.
        """
        self._check_open()
        if self._world.grip is not None:
            self._world.grip.release()
            self._world.grip = None

    def close(self, timeout: float = 5.0) -> None:  # noqa: ARG002
        """Fix the tool where the person holds it.

        Args:
            timeout: Ignored.

        Raises:
            DeviceError: The mount is closed.
        """
        self._check_open()
        world = self._world
        if world.grip is not None:
            return
        X_mount_tool = inverse(world.X_base_hand()) @ world.X_base_tool()
        handle = world.tool.tool.handle
        z = float(np.clip(-X_mount_tool[0, 3] / X_mount_tool[0, 2], handle.z_min, handle.z_max))
        world.grip = AssistedGrip(
            world.client,
            world.robot.body,
            world.robot.palm,
            world.tool.body,
            inverse(world.tool.X_tool_inertial),
            X_mount_tool[:3, 3] + z * X_mount_tool[:3, 2],
            GripLimits.clamped(),
            NORMAL.time_step,
        )

    def stop(self) -> None:
        """Do nothing: a mount does not move by itself."""

    def _check_open(self) -> None:
        if not self._open_device:
            raise DeviceError("the mount is closed: use it inside its `with` block", code="device.closed")
