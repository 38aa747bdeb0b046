"""The arms that the contract suite runs on, and what can be done to each from outside."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace

import numpy as np
import pybullet as pb
import pytest

from tests.sim_backend.kinematics import joints_for_hand, line
from tests.stand_in import HOME, PATIENT, held, patient, stand_in
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array, transform
from toolee_robot.hal import ZERO_TIME, Arm, ContactGuard, MotionReport, MotionWatch
from toolee_robot.runtime.clock import is_loopback
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.devices.arm import SimArm
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import STOP_ROOM, ArmLimits, sim_station
from toolee_robot.types import ArmModel, Payload, Trajectory

NUDGE = np.array([0.25, -0.15, 0.2, 0.1, -0.2, 0.3])


class Rig(ABC):
    """An entered arm: its rate [Hz], limits and tolerances [rad, s, N], and which faults can be brought about."""

    arm: Arm
    rate: float
    limits: ArmLimits
    tracking = 1e-3
    reading = 1e-6
    watch = PATIENT
    force_time = 0.2
    zeroed = 3.0
    carried = Payload(1.5, np.array([0.0, 0.01, 0.08]))
    faults = True
    disturbed = False

    def start(self) -> Array:
        """(6,) [rad] The commanded position that the next motion starts from."""
        return held(self.arm)

    def nudge(self, duration: float = 1.0, share: float = 1.0) -> Trajectory:
        """Away from where the arm is and back the next time, so that tests follow one another."""
        q = self.start()
        towards = HOME + NUDGE if np.abs(q - HOME).max() < 0.12 else HOME
        return line([q, q + share * (towards - q)], duration)

    def execute(self, trajectory: Trajectory, guard: ContactGuard | None = None) -> MotionReport:
        return self.arm.execute(trajectory, guard, self.watch)

    @abstractmethod
    def now(self) -> float: ...

    @abstractmethod
    def sleep(self, duration: float) -> None: ...

    @abstractmethod
    def after(self, delay: float, action: Callable[[], object]) -> None:
        """Do it `delay` [s] from now, while the arm moves; from another thread where the arm has one of its own."""

    @abstractmethod
    def true_joints(self) -> tuple[Array, Array]:
        """q, qd as the robot itself has them."""

    @abstractmethod
    def contact(self) -> tuple[Trajectory, ContactGuard]:
        """A motion that will meet something after a while."""

    @abstractmethod
    def protective_stop(self) -> None: ...

    @abstractmethod
    def emergency_stop(self) -> None: ...

    @abstractmethod
    def make_ready(self) -> None:
        """What a person does at the robot after a stop."""

    @abstractmethod
    def hold_up(self) -> None:
        """From now on a joint is not where it was commanded to."""

    @abstractmethod
    def cut(self) -> None:
        """From now on no data comes."""

    @abstractmethod
    def restore(self) -> None: ...

    @abstractmethod
    def reopened(self) -> Arm:
        """The same arm, not entered."""

    def recover(self) -> None:
        """Ready for the next test."""
        if self.disturbed:
            self.restore()
            self.make_ready()
            self.sleep(0.15)
            self.disturbed = False
        deadline = time.monotonic() + 10.0
        while True:
            try:
                self.arm.reset()
                return
            except DeviceError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.1)


class SimRig(Rig):
    """The arm in the pybullet world: time goes on only while it moves or sleeps."""

    rate = 125.0

    def __init__(self, simulation: SimStation, limits: ArmLimits) -> None:
        self._simulation, self.limits = simulation, limits
        arm = simulation.station.arm
        assert isinstance(arm, SimArm)
        self.arm: SimArm = arm
        robot = simulation.world.robot.robot
        self.carried = robot.hand_payload(robot.hand_open)

    def now(self) -> float:
        return self._simulation.station.clock.now()

    def sleep(self, duration: float) -> None:
        self._simulation.station.clock.sleep(duration)

    def after(self, delay: float, action: Callable[[], object]) -> None:
        due, done = self.now() + delay, [False]

        def look(_sample: object) -> None:
            if not done[0] and self.now() >= due:
                done[0] = True
                action()

        self._simulation.observers.append(look)

    def true_joints(self) -> tuple[Array, Array]:
        return self._simulation.world.robot.arm_state()

    def contact(self) -> tuple[Trajectory, ContactGuard]:
        world = self._simulation.world
        hand = world.X_base_hand()
        down = joints_for_hand(transform(p=[0.0, 0.0, -0.25]) @ hand, HOME)
        tip = (hand @ [0.0, 0.0, 0.15, 1.0])[:3]
        shape = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=[0.1, 0.1, 0.05], physicsClientId=world.client)
        at = [tip[0], tip[1], tip[2] - 0.13 - 0.05]
        box = pb.createMultiBody(0.0, shape, -1, at, physicsClientId=world.client)
        # As foam rubber: something rigid would have the robot stop itself, before the arm has braked on its path.
        pb.changeDynamics(box, -1, contactStiffness=5e3, contactDamping=100.0, physicsClientId=world.client)
        return line([self.start(), down], 1.5), ContactGuard(force=15.0, ignore_before=0.05)

    def protective_stop(self) -> None:
        self.arm.protective_stop()

    def emergency_stop(self) -> None:
        self.arm.emergency_stop()

    def make_ready(self) -> None:
        self.arm.make_ready()

    def hold_up(self) -> None:
        self.arm.block_joint(0)

    def cut(self) -> None:
        self.arm.cut_link()

    def restore(self) -> None:
        self.arm.restore_link()

    def reopened(self) -> Arm:
        return self.arm


class StandInRig(Rig):
    """UnsupervisedUrArm on the controller stand-in, over the loopback address `host`."""

    def __init__(
        self, arm: UnsupervisedUrArm, controller: ControllerProcess, model: ArmModel, limits: ArmLimits
    ) -> None:
        self.arm: UnsupervisedUrArm = arm
        self.controller, self.limits = controller, limits
        self.rate = 500.0 if model is ArmModel.UR10E else 125.0

    def now(self) -> float:
        return time.monotonic()

    def sleep(self, duration: float) -> None:
        time.sleep(duration)

    def after(self, delay: float, action: Callable[[], object]) -> None:
        timer = threading.Timer(delay, action)
        timer.daemon = True
        timer.start()

    def true_joints(self) -> tuple[Array, Array]:
        state = self.controller.state()
        return np.array(state["q"]), np.array(state["qd"])

    def contact(self) -> tuple[Trajectory, ContactGuard]:
        self.after(0.5, lambda: self.controller.fault("force", wrench=[30.0, 0, 0, 0, 0, 0], seconds=0.5))
        return self.nudge(1.5), ContactGuard(force=15.0, ignore_before=0.05)

    def protective_stop(self) -> None:
        self.controller.fault("protective_stop")

    def emergency_stop(self) -> None:
        self.controller.fault("emergency_stop")

    def make_ready(self) -> None:
        self.controller.fault("reset")

    def hold_up(self) -> None:
        # Less than the 0.2 rad at which the stand-in itself stops.
        self.controller.fault("joint_offset", offset=[0.15, 0, 0, 0, 0, 0])

    def cut(self) -> None:
        self.controller.fault("half_open", port="rtde")

    def restore(self) -> None:
        """The dead connections stay dead; new ones work."""

    def reopened(self) -> Arm:
        return UnsupervisedUrArm(patient(self.controller.host), self.limits)


GENTLE_SPEED, GENTLE_ACCELERATION = 0.1, 1.0
"""[rad/s], [rad/s^2] Of a joint: what the suite commands a robot at most, whether or not it should be refused."""


def gentle(trajectory: Trajectory) -> bool:
    """Whether a trajectory stays within the bounds above, by its numbers and by the way between its samples."""
    q = trajectory.q[np.isfinite(trajectory.q).all(axis=1)]
    way, steps = np.abs(np.diff(trajectory.q, axis=0)), np.diff(trajectory.times)[:, None]
    fast = (
        np.nanmax(np.abs(trajectory.qd), initial=0.0) > GENTLE_SPEED
        or np.nanmax(np.where(np.isfinite(trajectory.qdd), np.abs(trajectory.qdd), 0.0)) > GENTLE_ACCELERATION
        or np.nanmax(way / steps, initial=0.0) > GENTLE_SPEED
    )
    return len(q) > 0 and not fast


FORCE_NOISE = {ArmModel.UR10: (3.6, 0.02), ArmModel.UR10E: (1.5, 0.004)}
"""Noise of the force at rest: standard deviation of an axis [N], and its correlation time [s]. The CB3's 3.6 N are a
user's (UR forum, topic 229); the rest is assumed, as in the stand-in's harsh profile."""
NOISE_MARGIN = 4.5
"""Standard deviations of an axis that the norm of a zeroed average may be: noise alone exceeds them once in 6,600
times. The 7 N that a CB3's force is off without a zero exceed them by over three deviations of the average."""


def zeroed_force(model: ArmModel, duration: float) -> float:
    """[N] Largest norm of a zeroed force, averaged over `duration` [s]: its own noise and that of its zero."""
    deviation, correlation = FORCE_NOISE[model]
    return NOISE_MARGIN * deviation * np.sqrt(2.0 * correlation * (1.0 / duration + 1.0 / ZERO_TIME))


def hardware_watch(host: str) -> MotionWatch:
    """The driver's own bounds: a machine that cannot keep them moves no robot."""
    watch = MotionWatch()
    if is_loopback(host):
        watch = replace(watch, data_cycles=PATIENT.data_cycles, overruns=PATIENT.overruns)
    return watch


class HardwareRig(Rig):
    """A robot that stands somewhere. Motions are small and slow; nothing here brings it to harm on purpose."""

    faults = False
    tracking = 5e-3
    reading = 1e-3
    force_time = 2.0

    def __init__(self, arm: UnsupervisedUrArm, limits: ArmLimits, host: str) -> None:
        self.arm: UnsupervisedUrArm = arm
        self.watch = hardware_watch(host)
        self.zeroed = max(Rig.zeroed, zeroed_force(limits.model, self.force_time))
        self.limits, self.rate = limits, arm.rate
        self._home = held(arm)

    def nudge(self, duration: float = 1.0, share: float = 1.0) -> Trajectory:
        q = self.start()
        towards = self._home + 0.1 * NUDGE if np.abs(q - self._home).max() < 0.005 else self._home
        return line([q, q + share * (towards - q)], 3.0 * duration)

    def execute(self, trajectory: Trajectory, guard: ContactGuard | None = None) -> MotionReport:
        """Not even what the driver has to refuse is commanded faster."""
        if not gentle(trajectory):
            pytest.skip("too fast to be commanded to a robot")
        return super().execute(trajectory, guard)

    def now(self) -> float:
        return time.monotonic()

    def sleep(self, duration: float) -> None:
        time.sleep(duration)

    def after(self, delay: float, action: Callable[[], object]) -> None:
        threading.Timer(3.0 * delay, action).start()

    def true_joints(self) -> tuple[Array, Array]:
        joints = self.arm.state().joints
        return joints.q, joints.qd

    def contact(self) -> tuple[Trajectory, ContactGuard]:
        raise NotImplementedError

    protective_stop = emergency_stop = make_ready = hold_up = cut = restore = lambda _self: None

    def reopened(self) -> Arm:
        raise NotImplementedError


@contextmanager
def sim_rig() -> Iterator[Rig]:
    config = sim_station()
    with SimStation.build(config, 0, SimOptions(q_start=HOME, hands_over=False)) as simulation:
        yield SimRig(simulation, config.arm)


@contextmanager
def stand_in_rig(model: ArmModel, host: str) -> Iterator[Rig]:
    limits = replace(sim_station().arm, model=model)
    with ExitStack() as stack:
        controller = stack.enter_context(stand_in(model, host))
        arm = stack.enter_context(UnsupervisedUrArm(patient(host), limits))
        yield StandInRig(arm, controller, model, limits)


@contextmanager
def hardware_rig(model: ArmModel, host: str) -> Iterator[Rig]:
    limits = replace(sim_station().arm, model=model, acceleration=(GENTLE_ACCELERATION / STOP_ROOM,) * 6)
    with UnsupervisedUrArm(UrArmConfig(host), limits) as arm:
        yield HardwareRig(arm, limits, host)
