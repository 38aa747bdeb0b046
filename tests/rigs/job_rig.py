"""A simulated station with the hammer already in the hand, restored between jobs.

Only the handover is skipped: arm, hand, grip, camera, nail and clock are those of the simulation.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Self

import numpy as np

from tests.rigs.people import People
from toolee_robot.control import CollisionWorld, RobotModel, StrikePlan, plan_handover
from toolee_robot.control.arm_dynamics import ArmDynamics, bound_stop
from toolee_robot.frames import inverse
from toolee_robot.hal import Hand, HandState, MotionReport, Person, RgbdCamera, Station
from toolee_robot.robots import SHADOW_HAND
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.devices.arm import SimArm
from toolee_robot.sim_backend.devices.camera import SimCamera
from toolee_robot.sim_backend.devices.hand import SimHand
from toolee_robot.sim_backend.physics.bodies import pb
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.station import StationConfig, TaskConfig, sim_station
from toolee_robot.tasks.common.look import Perceiver
from toolee_robot.tasks.common.observer import HandCourse, TaskObserver
from toolee_robot.tasks.common.outcome import HammerResult, Stage
from toolee_robot.tasks.hammering.grasp import Grasp, nominal_grasp
from toolee_robot.tasks.hammering.task import HammeringTask
from toolee_robot.types import Trajectory

# Transfers are not examined and may be fast.
CONFIG = replace(
    sim_station(),
    task=TaskConfig(views=1, max_strikes=1, handover_timeout=2.0),
    arm=replace(sim_station().arm, transfer_velocity_scale=0.7, transfer_acceleration=5.0),
)
HOME = np.array(CONFIG.scene.home)
SEED = 101


class ClosedHand:
    """The simulated hand closed around the hammer, which does not open."""

    def __init__(self, hand: SimHand) -> None:
        self._hand = hand
        self.opened = 0
        self.closed = False
        self.blinks = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self._hand.joint_names

    def state(self, max_age: float = 0.1) -> HandState:
        state = self._hand.state(max_age)
        if self.closed and not self.blinks:
            return state
        self.blinks = max(self.blinks - 1, 0)
        return replace(state, holding=False)

    def open(self, timeout: float = 5.0) -> None:
        if self._hand.hangs:
            self._hand.open(timeout)
        self.opened += 1
        self.closed = False

    def close(self, timeout: float = 5.0) -> None:
        if self._hand.hangs:
            self._hand.close(timeout)
        self.closed = True

    def stop(self) -> None:
        self._hand.stop()


def _nothing() -> None: ...


class Log(TaskObserver):
    """Records the events of a task, and calls actions at given events."""

    def __init__(
        self, at: dict[Stage, Callable[[], None]] | None = None, after: dict[str, Callable[[], None]] | None = None
    ) -> None:
        self.motions: list[str] = []
        self.messages: list[str] = []
        self.plan: StrikePlan | None = None
        self.last: HammerResult | None = None
        self.at, self.after = at or {}, after or {}

    def stage_started(self, stage: Stage) -> None:
        self.at.pop(stage, _nothing)()

    def message(self, text: str) -> None:
        self.messages.append(text)

    def planned(self, stamp: float, plan: StrikePlan) -> None:  # noqa: ARG002
        self.plan = plan

    def motion(self, name: str, report: MotionReport, hand: HandCourse) -> None:
        assert len(report.stamps) > 0
        assert all(q.shape == (len(SHADOW_HAND.joints),) for _, q in hand)
        self.motions.append(name)
        self.after.pop(name, _nothing)()

    def ended(self, result: HammerResult) -> None:
        self.last = result


class Bench:
    """The station with the hammer in the hand at the handover position; `reset` restores it."""

    def __init__(self, config: StationConfig = CONFIG) -> None:
        self._robot = robot = RobotModel.of_station(config)
        q_open = robot.description.hand_open
        way = plan_handover(robot, config, CollisionWorld(robot, config, q_open), HOME, q_open)
        self.sim = SimStation.build(config, SEED, SimOptions(q_start=way.q[-1]))
        station, world = self.sim.station, self.sim.world
        assert station.person.request_handover("", 10.0)
        station.hand.close()
        assert station.person.release("", 10.0)
        assert station.hand.state().holding
        X_hand_tool = inverse(world.X_base_hand()) @ world.X_base_tool()
        self.true_grasp: Grasp = replace(nominal_grasp(self.sim.tool, config), X_hand_tool=X_hand_tool)
        self._spec = world.nail.spec
        self._callbacks = list(world.before_step), list(world.after_step)
        self.keep()
        self.reset()

    def keep(self) -> None:
        """Save the present state as the one that `reset` restores."""
        world = self.sim.world
        self._q_hand = world.robot.q_hand_target.copy()
        self._q = world.robot.q_arm_target.copy()
        self._grip = copy.deepcopy(world.grip)
        self._state = pb.saveState(physicsClientId=world.client)

    def bounded(self, strike: Trajectory) -> Trajectory:
        """The strike as the supervisor sends it: with stops that keep the joints' torques with the held hammer."""
        grasp, q_hand = self.true_grasp, self.sim.station.hand.state().joints.q
        payload = self._robot.payload(q_hand, grasp.X_hand_tool, grasp.mass, grasp.p_tool_com)
        return bound_stop(strike, ArmDynamics.with_payload(self._robot, q_hand, payload), CONFIG.arm.model)

    def reset(self) -> None:
        """Restore the saved state, with new devices and people."""
        world = self.sim.world
        world.observers.clear()
        world.before_step[:], world.after_step[:] = self._callbacks
        pb.restoreState(stateId=self._state, physicsClientId=world.client)
        world.grip = copy.deepcopy(self._grip)
        world.nail.spec = self._spec
        world.robot.command_arm(self._q, np.zeros(6))
        world.robot.command_hand(self._q_hand)
        assert isinstance(self.sim.station.hand, SimHand)
        assert isinstance(self.sim.station.camera, SimCamera)
        self.sim_hand, self.sim_camera = self.sim.station.hand, self.sim.station.camera
        self.sim_hand.recover()
        self.sim_camera.thaw()
        self.camera: RgbdCamera = self.sim_camera
        self.camera_serial = self.sim.station.camera_serial
        self.arm = SimArm(world)
        self.hand: ClosedHand = ClosedHand(self.sim_hand)
        self.people = People()
        self.person: Person = self.people
        world.advance(0.1)  # so that the ground truth, too, reflects the restored state

    @property
    def station(self) -> Station:
        hand: Hand = self.hand
        return replace(
            self.sim.station, arm=self.arm, hand=hand, camera=self.camera, person=self.person,
            camera_serial=self.camera_serial,
        )  # fmt: skip

    def blind_task(self, log: TaskObserver, config: StationConfig = CONFIG) -> HammeringTask:
        """Make a job that uses the true grasp without looking."""
        return HammeringTask(self.station, None, config, self.true_grasp, observer=log)

    def seeing_task(
        self, log: TaskObserver, config: StationConfig = CONFIG, perceiver: Perceiver | None = None
    ) -> HammeringTask:
        """Make a job that looks."""
        perceiver = perceiver or PerfectPerception(self.sim.judge)
        return HammeringTask(self.station, perceiver, config, nominal_grasp(self.sim.tool, config), observer=log)

    @contextmanager
    def in_real_time(self) -> Iterator[None]:
        """Context in which the simulation does not run faster than real time, so that watching threads keep up."""
        world = self.sim.world
        due = time.monotonic()

        def keep(dt: float) -> None:
            nonlocal due
            now = time.monotonic()
            if due > now:
                time.sleep(due - now)
            due = max(due, now) + dt

        world.before_step.append(keep)
        try:
            yield
        finally:
            world.before_step.remove(keep)

    def drop(self) -> None:
        """Let the hand lose the hammer."""
        assert self.sim.world.grip is not None
        self.sim.world.grip.release()


def at_rest(sim: SimStation) -> bool:
    """Whether the arm is at rest at its commanded position, and remains so for 0.2 s."""
    robot = sim.world.robot
    q, qd = robot.arm_state()
    still = np.abs(qd).max() < 5e-3 and not robot.qd_arm_target.any() and np.abs(q - robot.q_arm_target).max() < 5e-3
    sim.world.advance(0.2)
    later, qd = robot.arm_state()
    return bool(still and np.abs(qd).max() < 5e-3 and np.abs(later - q).max() < 2e-3)


def grip_kept(sim: SimStation) -> bool:
    return sim.world.grip is not None and sim.world.grip.holding
