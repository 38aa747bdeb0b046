"""A UR10 or UR10e over ur_rtde: `hal.Arm`, whose servo loop runs in a process of its own.

    limits = ArmLimits(model=ArmModel.UR10)
    with UrArm(UrArmConfig("192.168.1.10"), limits) as arm:
        q = arm.state().q_commanded
        arm.execute(joint_move(q, q_goal, ...))

None of this is a safety function: the robot's own safety system is, with its limits set for this task.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import Final, Self

import numpy as np

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.config import ArmLimits
from toolee_robot.errors import (
    DeviceError,
    LatchedError,
    MotionFaultError,
    NotReadyError,
    ServoCrashError,
    StaleDataError,
)
from toolee_robot.findings import Level
from toolee_robot.frames import Array
from toolee_robot.hal import ArmState, ArmStatus, ContactGuard, MotionReport, MotionWatch
from toolee_robot.hardware.ur.checks import UrExpected, check
from toolee_robot.hardware.ur.config import UrArmConfig, servo_lag
from toolee_robot.hardware.ur.probe import nominal_rate, probe
from toolee_robot.hardware.ur.servo.client import ServoClient
from toolee_robot.hardware.ur.servo.clock import Realtime
from toolee_robot.hardware.ur.servo.messages import Cause, Freedrive, MotionEnded, MotionRequest, SetPayload
from toolee_robot.hardware.ur.servo.report import build_report, fault
from toolee_robot.hardware.ur.servo.shared_memory import StateColumn, Word
from toolee_robot.hardware.ur.status import advice, arm_status
from toolee_robot.motion.trajectory_checks import check_payload, check_trajectory
from toolee_robot.runtime.gc_pause import gc_paused
from toolee_robot.types import JointState, Payload, Trajectory

POSITION: Final = np.array([2.0, 2.0, 1.0, 2.0, 2.0, 2.0]) * np.pi  # [rad], either way; the elbow as modelled
PROBES: Final = 3
TIMING: Final = {"RTDE rate", "RTDE jitter", "clock"}
"""Findings that may be this machine's fault, and are looked into up to PROBES times."""
_POLL: Final = 0.02  # [s]


class UrArm:
    """See the module. rate [Hz], realtime: known once the context is entered."""

    def __init__(self, config: UrArmConfig, limits: ArmLimits) -> None:
        self._config, self._limits, self._clock = config, limits, config.clock
        self._velocity = np.minimum(limits.velocity, ARM_DATA[limits.model].velocity)
        self._rate, self._lag = 0.0, 0.0
        self._servo: ServoClient | None = None
        self._fault: MotionFaultError | None = None
        self._payload: Payload | None = None
        self._busy = threading.Lock()

    def __enter__(self) -> Self:
        """Check the robot and connect; nothing moves. Raises NotReadyError, naming all that a person must do first, and
        what `reset` raises."""
        tcp = None if self._config.tcp is None else np.array(self._config.tcp)
        expected = UrExpected(self._limits.model, self._limits.calibration, self._config.payload, tcp)
        for _ in range(PROBES):
            report = probe(self._config.host, clock=self._clock)
            failed = [finding for finding in check(report, expected) if finding.level is Level.FAIL]
            # A second in which this machine was busy says nothing of the robot; a clock that goes back, or does not
            # come at all, does.
            quality = report.quality
            ours = quality is not None and not quality.backward and all(f.name in TIMING for f in failed)
            if not failed or not ours:
                break
        if failed or report.version is None:
            lines = "\n  ".join(map(str, failed))
            raise NotReadyError(f"the robot at {self._config.host} is not ready:\n  {lines}")
        self._rate = nominal_rate(report.version)
        self._lag = servo_lag(self._config, self._rate)
        self._fault = None
        self._servo = ServoClient(self._config, self._rate)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        servo, self._servo = self._servo, None
        if servo is not None:
            servo.ask_to_stop()
            servo.close()

    @property
    def rate(self) -> float:
        return self._rate

    @property
    def lag(self) -> float:
        """[s] The most by which a measured position comes later than its command, as assumed here."""
        return self._lag

    @property
    def realtime(self) -> Realtime:
        """What the system granted the servo process."""
        return self._open().realtime

    @property
    def servo_pid(self) -> int:
        """Of the process that talks to the robot."""
        return self._open().pid

    def state(self, max_age: float = 0.1) -> ArmState:
        """The newest reading, stamped with the station's clock when it came. Raises StaleDataError."""
        state = self._open().memory.read_state()
        age = self._clock.now() - state[StateColumn.SEEN]
        if age > max_age:
            raise StaleDataError(
                f"the arm's newest state is {age:.2f} s old: check the robot and its network cable, then reset the arm"
            )
        joints = JointState(state[StateColumn.Q], state[StateColumn.QD], float(state[StateColumn.SEEN]))
        return ArmState(joints, state[StateColumn.COMMANDED], state[StateColumn.WRENCH], _status(state))

    def execute(
        self, trajectory: Trajectory, guard: ContactGuard | None = None, watch: MotionWatch | None = None
    ) -> MotionReport:
        """See `hal.Arm`. Ctrl-C brakes the arm on the path first, and is raised when it stands."""
        with self._exclusive():
            servo = self._ready()
            q_commanded = servo.memory.read_state()[StateColumn.COMMANDED]
            check_trajectory(trajectory, q_commanded, -POSITION, POSITION, self._velocity)
            samples, knots = servo.memory.write_path(trajectory, self._rate)
            limits = self._limits
            request = MotionRequest(
                samples,
                knots,
                guard,
                watch or MotionWatch(),
                limits.stop_acceleration,
                limits.stop_jerk,
                self._lag,
                int(servo.memory.words[Word.STOP]),
            )
            servo.memory.words[Word.ROWS] = 0
            try:
                with gc_paused():
                    cause = self._move(servo, request)
            except ServoCrashError as error:
                raise self._latch(ServoCrashError(str(error), build_report(servo.memory, Cause.LINK))) from error
        report = build_report(servo.memory, cause)
        if cause >= Cause.DATA:
            raise self._latch(fault(cause, self._status_now(servo), report))
        return report

    def set_payload(self, payload: Payload) -> None:
        """Tell the controller what the flange carries. Raises LimitError for what this arm may not carry, DeviceError
        when the controller does not report it back."""
        check_payload(payload, ARM_DATA[self._limits.model].payload)
        with self._exclusive():
            self._ask(_payload_request(payload))
            self._payload = payload

    @contextmanager
    def freedrive(self) -> Iterator[None]:
        """A person moves the arm by hand inside this context, and nothing else does; it holds its place afterwards.
        Raises DeviceError when the robot refuses."""
        with self._exclusive():
            self._ask(Freedrive(True))
            try:
                yield
            finally:
                self._ask(Freedrive(False))

    def stop(self) -> None:
        """See `hal.Arm`: any thread, any time; `execute` then returns."""
        if self._servo is not None:
            self._servo.ask_to_stop()

    def reset(self) -> None:
        """See `hal.Arm`. A latched arm gets a new servo process and connection. Raises NotReadyError as long as a
        person has to make the robot ready, DeviceError when it does not answer, ServoCrashError."""
        with self._exclusive():
            servo = self._open()
            self._notice(servo)
            if self._fault is None:
                return
            with suppress(StaleDataError):
                status = self.state().status
                if status is not ArmStatus.READY:
                    raise NotReadyError(advice(status))
            servo.close()
            self._servo = servo = ServoClient(self._config, self._rate)
            self._fault = None
            if self._payload is not None:
                self._ask(_payload_request(self._payload))

    def _open(self) -> ServoClient:
        if self._servo is None:
            raise DeviceError("the arm is closed: use it inside its `with` block")
        return self._servo

    @contextmanager
    def _exclusive(self) -> Iterator[None]:
        if not self._busy.acquire(blocking=False):
            raise DeviceError("the arm is busy with another motion, or in freedrive")
        try:
            yield
        finally:
            self._busy.release()

    def _ready(self) -> ServoClient:
        """The servo process of an arm that may move."""
        servo = self._open()
        self._notice(servo)
        if self._fault is not None:
            raise LatchedError(f"the arm is latched since: {self._fault}")
        return servo

    def _notice(self, servo: ServoClient) -> None:
        """Latch what has happened at rest."""
        if self._fault is not None:
            return
        cause = Cause(int(servo.memory.words[Word.CAUSE]))
        if cause >= Cause.DATA:
            self._latch(fault(cause, self._status_now(servo), None))
        elif not servo.alive:
            self._latch(servo.crash())
        elif not servo.cycles_within(self._config.hang_timeout):
            self._latch(servo.crash(hung=True))

    def _latch(self, error: MotionFaultError) -> MotionFaultError:
        if self._fault is None:
            self._fault = error
        return error

    def _ask(self, request: SetPayload | Freedrive) -> None:
        try:
            self._ready().ask(request)
        except ServoCrashError as error:
            raise self._latch(error) from error

    def _move(self, servo: ServoClient, request: MotionRequest) -> Cause:
        """Request a motion and wait for its end, as long as the servo process gives signs of life."""
        try:
            servo.send(request)
            return self._await(servo)
        except BaseException as error:
            # Ctrl-C, or anything else that hits this thread: the arm stands before it is raised.
            if not isinstance(error, MotionFaultError):
                servo.ask_to_stop()
                self._await(servo)
            raise

    def _await(self, servo: ServoClient) -> Cause:
        cycles, since = -1, self._clock.now()
        while True:
            reply = servo.receive(_POLL)
            if isinstance(reply, MotionEnded):
                return reply.cause
            if reply is not None:
                servo.kill()
                raise ServoCrashError(f"the servo process answered {reply!r} to a motion: reset the arm")
            now, done = self._clock.now(), int(servo.memory.words[Word.CYCLES])
            if done != cycles:
                cycles, since = done, now
            elif now - since > self._config.hang_timeout:
                raise servo.crash(hung=True)

    @staticmethod
    def _status_now(servo: ServoClient) -> ArmStatus:
        return _status(servo.memory.read_state())


def _status(state: Array) -> ArmStatus:
    return arm_status(int(state[StateColumn.SAFETY_BITS]), int(state[StateColumn.ROBOT_MODE]))


def _payload_request(payload: Payload) -> SetPayload:
    return SetPayload(payload.mass, [float(c) for c in payload.center_of_mass])
