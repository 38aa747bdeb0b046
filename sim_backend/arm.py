"""The simulated arm: position commands at the controller's rate, force sensing at the flange, braking."""

from __future__ import annotations

from types import TracebackType
from typing import Self

import numpy as np

from toolee_robot.arm_checks import check_payload, check_trajectory
from toolee_robot.braking import brake_on_path
from toolee_robot.errors import DeviceError, StaleDataError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmState, ContactGuard, MotionOutcome, MotionReport, MotionWatch
from toolee_robot.sim_backend.flange_sensor import FlangeSensor
from toolee_robot.sim_backend.world import SimWorld
from toolee_robot.types import JointState, Payload, Trajectory

RATE = 125.0  # [Hz] of a CB3 controller
CAPACITY = 10.0  # [kg]
STANDSTILL = 2e-3  # [rad/s]
SETTLE_TIME = 1.0  # [s] at most, after the last command


class SimArm:
    """A `hal.Arm` that moves the simulated UR10."""

    def __init__(self, world: SimWorld) -> None:
        self._world = world
        robot = world.robot.robot
        self._lower, self._upper = robot.lower[:6], robot.upper[:6]
        self._limits = world.config.arm
        self._velocity = np.minimum(np.array(self._limits.velocity), robot.velocity[:6])
        self._sensor = FlangeSensor(world, robot.hand_payload(robot.hand_open), 1 / RATE)
        world.wrench = lambda: self._sensor.wrench.copy()
        self._q, self._qd = world.robot.q_arm_target.copy(), np.zeros(6)
        self._open, self._moving, self._stop_asked = True, False, False
        self._last: ArmState | None = None  # the newest state that arrived, while the link is down

    def __enter__(self) -> Self:
        self._open = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        self._open = False

    @property
    def rate(self) -> float:
        return RATE

    def state(self, max_age: float = 0.1) -> ArmState:
        """The present state. Raises StaleDataError once the link is down for longer than max_age [s]."""
        self._check_open()
        if self._last is None:
            return self._read()
        age = self._world.time - self._last.joints.stamp
        if age > max_age:
            raise StaleDataError(f"the arm's newest state is {age:.2f} s old: check its network link, then start again")
        return self._last

    def _read(self) -> ArmState:
        q, qd = self._world.robot.arm_state()
        return ArmState(JointState(q, qd, self._world.time), self._sensor.wrench.copy())

    def cut_link(self) -> None:
        """From now on the arm's states do not arrive any more, as with a pulled network cable."""
        self._last = self._read()

    def restore_link(self) -> None:
        """They arrive again."""
        self._last = None

    def set_payload(self, payload: Payload) -> None:
        """What the flange carries, hand included: for the compensation of the sensed wrench."""
        check_payload(payload, CAPACITY)
        self._sensor.payload = payload

    def execute(
        self,
        trajectory: Trajectory,
        guard: ContactGuard | None = None,
        watch: MotionWatch | None = None,
    ) -> MotionReport:
        """See `hal.Arm`. Raises LimitError, and nothing moves, when the trajectory breaks a limit; StaleDataError,
        after braking, when the link goes down on the way."""
        self._check_open()
        check_trajectory(trajectory, self._q, self._lower, self._upper, self._velocity)
        log = _Log()
        contact: JointState | None = None
        outcome = MotionOutcome.COMPLETED
        self._stop_asked, self._moving = False, True
        t = 0.0
        try:
            for k in range(1, int(np.ceil(trajectory.duration * RATE - 1e-9)) + 1):
                t = min(k / RATE, trajectory.duration)
                self._command(*trajectory.sample(t))
                self._tick(log)
                self.state(max_age=2.5 / RATE)
                if self._stop_asked:
                    outcome = MotionOutcome.STOPPED
                    break
                force = float(np.linalg.norm(self._sensor.wrench[:3]))
                if guard is not None and t >= guard.after and force > guard.force:
                    outcome = MotionOutcome.CONTACT
                    contact = JointState(*self._world.robot.arm_state(), self._world.time)
                    break
        finally:
            # After an exception as well as after the last sample: the arm comes to rest before anyone goes on.
            self._brake(trajectory, t, log)
            self._moving = False
        return MotionReport(
            outcome,
            np.array(log.stamps),
            np.array(log.commanded),
            np.array(log.measured),
            np.array(log.wrenches),
            contact,
        )

    def stop(self) -> None:
        """Brake from the last commanded state; during `execute` (from a callback) it ends that motion."""
        if self._moving:
            self._stop_asked = True

    def reset(self) -> None:
        """Nothing latches yet."""
        self._check_open()

    def _check_open(self) -> None:
        if not self._open:
            raise DeviceError("the arm is closed: use it inside its `with` block")

    def _command(self, q: Array, qd: Array) -> None:
        """A sample that is due one tick from now: the robot moves towards it with the mean velocity of the tick."""
        step = (q - self._q) * RATE
        self._world.robot.command_arm(self._q, step)
        self._q, self._qd = np.array(q), np.array(qd)

    def _tick(self, log: _Log) -> None:
        self._sensor.begin()
        self._world.advance(1 / RATE)
        log.stamps.append(self._world.time)
        log.commanded.append(self._q.copy())
        log.measured.append(self._world.robot.arm_state()[0])
        log.wrenches.append(self._sensor.wrench.copy())

    def _brake(self, trajectory: Trajectory, t: float, log: _Log) -> None:
        """To rest on the trajectory's own path, from time t [s] on it."""
        limits = self._limits
        for q, qd in brake_on_path(trajectory, t, 1 / RATE, limits.stop_acceleration, limits.stop_jerk):
            self._command(q, qd)
            self._tick(log)
        self._qd = np.zeros(6)
        self._world.robot.command_arm(self._q, self._qd)
        for _ in range(int(SETTLE_TIME * RATE)):
            self._tick(log)
            if np.abs(self._world.robot.arm_state()[1]).max() < STANDSTILL:
                break


class _Log:
    def __init__(self) -> None:
        self.stamps: list[float] = []
        self.commanded: list[Array] = []
        self.measured: list[Array] = []
        self.wrenches: list[Array] = []
