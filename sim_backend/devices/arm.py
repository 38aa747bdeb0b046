"""The simulated arm: position commands at the controller's rate, force sensing at the flange, braking."""

from __future__ import annotations

from types import TracebackType
from typing import Self

import numpy as np

from toolee_robot.arm_data import ARM_DATA, CB3_RATE
from toolee_robot.errors import (
    DeviceError,
    EmergencyStopError,
    LatchedError,
    LinkLostError,
    MotionFaultError,
    OverrunError,
    ProtectiveStopError,
    StaleDataError,
    TrackingError,
)
from toolee_robot.frames import Array
from toolee_robot.hal import ArmState, ArmStatus, ContactGuard, MotionOutcome, MotionReport, MotionWatch
from toolee_robot.motion.path_stop import stop_on_path
from toolee_robot.motion.trajectory_checks import check_payload, check_trajectory
from toolee_robot.sim_backend.devices.flange_sensor import FlangeSensor
from toolee_robot.sim_backend.world import SimWorld
from toolee_robot.types import JointState, Payload, Trajectory

RATE = CB3_RATE
STANDSTILL = 2e-3  # [rad/s]
SETTLE_TIME = 1.0  # [s] at most, after the last command
LATE = 0.6  # cycles by which a late command is late

Fault = tuple[type[MotionFaultError], str]


class SimArm:
    """A `hal.Arm` that moves the simulated UR10.

    Faults to be had: `cut_link`, `protective_stop`, `emergency_stop`, `stick`, `delay_commands`; `make_ready` and
    `restore_link` are what a person does at the robot after them.
    """

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
        self._status, self._latched = ArmStatus.READY, ""
        self._stuck: dict[int, float] = {}
        self._late, self._since = 0, 0.0
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

    @property
    def q_commanded(self) -> Array:
        """(6,) [rad] of the newest state, also while the link is down and none arrives."""
        return self._q.copy()

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
        return ArmState(JointState(q, qd, self._world.time), self._q.copy(), self._sensor.wrench.copy(), self._status)

    def _newest(self) -> ArmState:
        return self._read() if self._last is None else self._last

    def cut_link(self) -> None:
        """From now on the arm's states do not arrive any more, as with a pulled network cable."""
        self._last = self._read()

    def restore_link(self) -> None:
        """They arrive again."""
        self._last = None

    def protective_stop(self) -> None:
        """The robot stops itself."""
        self._status = ArmStatus.PROTECTIVE_STOP
        self._latched = self._latched or "the robot made a protective stop"

    def emergency_stop(self) -> None:
        """Somebody presses the emergency stop."""
        self._status = ArmStatus.EMERGENCY_STOP
        self._latched = self._latched or "the emergency stop was pressed"

    def make_ready(self) -> None:
        """What a person does at the robot: release what is pressed, free what is stuck, and enable it."""
        self._status = ArmStatus.READY
        self._stuck.clear()
        self._late = 0

    def block_joint(self, joint: int) -> None:
        """From now on a joint (0 to 5) stays where it is."""
        self._stuck[joint] = float(self._world.robot.arm_state()[0][joint])

    def delay_commands(self, cycles: int) -> None:
        """The next so many commands go out late."""
        self._late = cycles

    def set_payload(self, payload: Payload) -> None:
        """What the flange carries, hand included: for the compensation of the sensed wrench."""
        check_payload(payload, ARM_DATA[self._limits.model].payload)
        self._sensor.payload = payload

    def execute(
        self,
        trajectory: Trajectory,
        guard: ContactGuard | None = None,
        watch: MotionWatch | None = None,
    ) -> MotionReport:
        """See `hal.Arm`. Raises LimitError, and nothing moves, when the trajectory breaks a limit; LatchedError; after
        braking, a MotionFaultError that names what ended the motion."""
        self._check_open()
        if self._latched:
            raise LatchedError(f"{self._latched}: nothing moves until a person has looked and reset the arm")
        check_trajectory(trajectory, self._q, self._lower, self._upper, self._velocity)
        watch = MotionWatch() if watch is None else watch
        log = _Log()
        contact: JointState | None = None
        outcome, fault = MotionOutcome.COMPLETED, None
        self._stop_asked, self._moving = False, True
        t = 0.0
        try:
            for k in range(1, int(np.ceil(trajectory.duration * RATE - 1e-9)) + 1):
                t = min(k / RATE, trajectory.duration)
                self._command(*trajectory.sample(t), log)
                self._tick(log)
                fault = self._fault(watch, log)
                if fault is not None or self._stop_asked:
                    outcome = MotionOutcome.STOPPED
                    break
                if (
                    guard is not None
                    and t >= guard.ignore_before
                    and log.mean_force(guard.averaging_window) > guard.force
                ):
                    outcome = MotionOutcome.CONTACT
                    contact = JointState(*self._world.robot.arm_state(), self._world.time)
                    break
        finally:
            # After an exception as well as after the last sample: the arm comes to rest before anyone goes on.
            self._brake(trajectory, t, log)
            self._moving = False
        # What was stopped for another reason, a contact say, may not have followed either.
        fault = fault or self._fault(watch, log)
        report = log.report(outcome, contact)
        if fault is not None:
            error, what = fault
            self._latched = self._latched or what
            raise error(f"{what}; the arm has stopped on its path and is latched", report)
        return report

    def _fault(self, watch: MotionWatch, log: _Log) -> Fault | None:
        """What must end the motion now."""
        if self._status is ArmStatus.EMERGENCY_STOP:
            return EmergencyStopError, "the emergency stop was pressed: release it at the robot"
        if self._status is not ArmStatus.READY:
            return ProtectiveStopError, f"the robot stopped itself ({self._status}): look why, release it at the robot"
        age = self._world.time - self._newest().joints.stamp
        if age > watch.data_cycles / RATE + 1e-9:
            return LinkLostError, f"no data from the arm for {age * 1e3:.0f} ms: check its network link"
        # An old reading says nothing about where the arm is now.
        error = np.abs(log.measured[-1] - log.commanded[-1]) if age == 0.0 else np.zeros(6)
        if error.max() > watch.tracking_error:
            joint = int(error.argmax())
            return TrackingError, f"joint {joint + 1} is {error[joint]:.3f} rad away from where it was sent"
        if log.late_in_a_row > watch.overruns:
            return OverrunError, f"{log.late_in_a_row} commands in a row went out late: free the machine"
        return None

    def stop(self) -> None:
        """Brake from the last commanded state; during `execute` (from a callback) it ends that motion."""
        if self._moving:
            self._stop_asked = True

    def reset(self) -> None:
        """See `hal.Arm`. The arm holds where it stands now."""
        self._check_open()
        if self._status is not ArmStatus.READY:
            raise DeviceError(f"the robot is in {self._status.replace('_', ' ')}: a person must make it ready there")
        if self._last is not None:
            raise DeviceError("the arm does not answer: check its network link")
        self._latched = ""
        self._q, self._qd = self._world.robot.arm_state()[0], np.zeros(6)
        self._world.robot.command_arm(self._q, self._qd)

    def _check_open(self) -> None:
        if not self._open:
            raise DeviceError("the arm is closed: use it inside its `with` block")

    def _command(self, q: Array, qd: Array, log: _Log) -> None:
        """A sample that is due one tick from now: the robot moves towards it with the mean velocity of the tick."""
        late = self._late > 0
        self._since = LATE / RATE if late else 0.0
        log.count(late)
        if late:
            self._late -= 1
            self._sensor.begin()
            self._world.advance(self._since)  # with what was commanded before
        target, step = self._q.copy(), (q - self._q) * RATE
        for joint, place in self._stuck.items():
            target[joint], step[joint] = place, 0.0
        self._world.robot.command_arm(target + self._since * step, step)
        self._q, self._qd = np.array(q), np.array(qd)

    def _tick(self, log: _Log) -> None:
        if self._since == 0.0:
            self._sensor.begin()
        self._world.advance(1 / RATE - self._since)
        self._since = 0.0
        newest = self._newest()
        log.add(self._world.time, self._q, newest.joints.q, newest.wrench)

    def _brake(self, trajectory: Trajectory, t: float, log: _Log) -> None:
        """To rest on the trajectory's own path, from time t [s] on it."""
        limits = self._limits
        for q, qd in stop_on_path(trajectory, t, 1 / RATE, limits.stop_acceleration, limits.stop_jerk):
            self._command(q, qd, log)
            self._tick(log)
        self._command(self._q, np.zeros(6), log)
        for _ in range(int(SETTLE_TIME * RATE)):
            self._tick(log)
            if np.abs(self._world.robot.arm_state()[1]).max() < STANDSTILL:
                break


class _Log:
    """What was sent and measured. late_in_a_row: commands up to the newest that went out late."""

    def __init__(self) -> None:
        self.stamps: list[float] = []
        self.commanded: list[Array] = []
        self.measured: list[Array] = []
        self.wrenches: list[Array] = []
        self.late, self.late_in_a_row = 0, 0

    def add(self, stamp: float, commanded: Array, measured: Array, wrench: Array) -> None:
        self.stamps.append(stamp)
        self.commanded.append(commanded.copy())
        self.measured.append(measured)
        self.wrenches.append(wrench)

    def mean_force(self, duration: float) -> float:
        """[N] Of the mean over the last `duration` [s], or of the last reading if shorter; 0 until it has passed."""
        n = max(round(duration * RATE), 1)
        return float(np.linalg.norm(np.mean(self.wrenches[-n:], axis=0)[:3])) if len(self.wrenches) >= n else 0.0

    def count(self, late: bool) -> None:
        self.late += late
        self.late_in_a_row = self.late_in_a_row + 1 if late else 0

    def report(self, outcome: MotionOutcome, contact: JointState | None) -> MotionReport:
        stamps, commanded, measured, wrenches = map(
            np.array, (self.stamps, self.commanded, self.measured, self.wrenches)
        )
        return MotionReport(outcome, stamps, commanded, measured, wrenches, contact, self.late)
