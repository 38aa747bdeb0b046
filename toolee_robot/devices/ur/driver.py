"""Driver of a UR10 or UR10e over ur_rtde: a `hal.Arm` whose servo loop runs in a process of its own.

It checks that a motion starts where the arm is and stays within the joints' positions and velocities. It knows neither
the station nor the people in it: `control.Supervisor` checks those and calls the driver, and `stations.lab.open_arm`
gives a lab both in one. The name says so, because whoever calls `execute` here moves an arm that may hit anything.

Nothing here is a safety function: people are protected by the robot's own safety system, with its limits set for this
task.
"""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final, Self

import numpy as np

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control.motion.trajectory_checks import check_payload, check_trajectory
from toolee_robot.devices.ur.checks import Identity, require_ready
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.probe import nominal_rate
from toolee_robot.devices.ur.servo.client import ServoClient
from toolee_robot.devices.ur.servo.clock import Realtime
from toolee_robot.devices.ur.servo.messages import Cause, Freedrive, MotionRequest, SetPayload, ZeroWrench
from toolee_robot.devices.ur.servo.program_watch import NOT_ENDED
from toolee_robot.devices.ur.servo.report import arm_state, build_report, fault
from toolee_robot.devices.ur.servo.shared_memory import StateColumn, Word
from toolee_robot.devices.ur.status import ErrorLog, advice, check_speed_slider
from toolee_robot.errors import (
    DeviceError,
    LatchedError,
    MotionFaultError,
    NotReadyError,
    ServoCrashError,
    StaleDataError,
)
from toolee_robot.hal import ArmState, ArmStatus, ContactGuard, MotionReport, MotionWatch
from toolee_robot.runtime.latency_monitor import gc_paused
from toolee_robot.station import ArmLimits, servo_lag
from toolee_robot.types import Payload, Trajectory

POSITION_LIMIT: Final = np.array([2.0, 2.0, 1.0, 2.0, 2.0, 2.0]) * np.pi
"""[rad] Of the six joints, in both directions; the elbow's as in the robot model."""


class UnsupervisedUrArm:
    """A UR10 or UR10e: `hal.Arm`. `rate`, `lag` and `realtime` are known once the context is entered.

    Args:
        config: Address, servo settings, timeouts and expected installation of the robot.
        limits: Model, calibration and motion limits of the arm.
    """

    def __init__(self, config: UrArmConfig, limits: ArmLimits) -> None:
        self._config, self._limits, self._clock = config, limits, config.clock
        self._velocity = np.minimum(limits.velocity, ARM_DATA[limits.model].velocity)
        self._rate, self._lag = 0.0, 0.0
        self._servo: ServoClient | None = None
        self._errors: ErrorLog | None = None
        self._fault: MotionFaultError | None = None
        self._payload: Payload | None = None
        self._identity: Identity | None = None
        self._busy = threading.Lock()

    @property
    def serial(self) -> str | None:
        """Serial number that the robot reported when the context was entered; None if it reports none."""
        return None if self._identity is None else self._identity.serial

    def __enter__(self) -> Self:
        """Check the robot and connect; nothing moves.

        Raises:
            NotReadyError: A check failed; the message lists everything a person must do first.
            DeviceError: The robot does not answer or refuses the connection.
            ServoCrashError: The servo process died or hung while it connected.
        """
        self._identity = require_ready(self._config, self._limits)
        self._rate = nominal_rate(self._identity.version)
        self._lag = servo_lag(self._config.servo, self._rate)
        self._fault = None
        self._servo = ServoClient(self._config, self._rate)
        self._errors = ErrorLog(self._config.host, self._clock)
        return self

    def __exit__(self, *_: object) -> None:
        servo, self._servo = self._servo, None
        if servo is not None:
            servo.ask_to_stop()
            if not servo.close():
                warnings.warn(NOT_ENDED, RuntimeWarning, stacklevel=2)
        errors, self._errors = self._errors, None
        if errors is not None:
            errors.close()

    @property
    def rate(self) -> float:
        """Rate of the servo commands [Hz]: the controller's RTDE rate."""
        return self._rate

    @property
    def lag(self) -> float:
        """Assumed upper bound of the delay of a measured position behind its command [s]."""
        return self._lag

    @property
    def realtime(self) -> Realtime:
        """The real-time privileges that the operating system granted to the servo process."""
        return self._open().realtime

    @property
    def servo_pid(self) -> int:
        """Process id of the servo process, which talks to the robot."""
        return self._open().pid

    def state(self, max_age: float = 0.1) -> ArmState:
        """The newest reading of the arm.

        Args:
            max_age: Largest accepted age of the reading [s].

        Returns:
            The state, stamped on the station's clock with the time at which the reading was received.

        Raises:
            StaleDataError: The newest reading is older than `max_age`.
            DeviceError: The arm is closed.
        """
        state = self._open().memory.read_state()
        age = self._clock.now() - state[StateColumn.SEEN]
        if age > max_age:
            raise StaleDataError(
                f"the arm's newest state is {age:.2f} s old: check the robot and its network cable, then reset the arm",
                code="stale_data.arm",
            )
        return arm_state(state, self._errors)

    def execute(
        self, trajectory: Trajectory, guard: ContactGuard | None = None, watch: MotionWatch | None = None
    ) -> MotionReport:
        """Execute a trajectory and block until standstill; see `hal.Arm`.

        Ctrl-C stops the arm on the path first, and is raised once it stands.

        Args:
            trajectory: Joint trajectory that starts at the state's `q_commanded`.
            guard: Contact at which to stop; None for no contact detection.
            watch: Bounds checked in every cycle; the defaults of `MotionWatch` if None.

        Returns:
            What was sent and measured, one row per command cycle.

        Raises:
            LimitError: The trajectory breaks a limit, does not start where the arm is, or is too long.
            LatchedError: An earlier fault has not been reset.
            NotReadyError: The speed slider is not at 100 %; nothing is latched.
            MotionFaultError: A fault stopped the arm; it is latched from now on.
            DeviceError: The arm is closed or busy.
        """
        with self._exclusive():
            servo = self._ready()
            state = servo.memory.read_state()
            check_speed_slider(float(state[StateColumn.SPEED_SLIDER]))
            check_trajectory(trajectory, state[StateColumn.COMMANDED], -POSITION_LIMIT, POSITION_LIMIT, self._velocity)
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
            self._forget_errors()
            try:
                with gc_paused():
                    cause = servo.execute(request)
            except ServoCrashError as error:
                raise self._latch(ServoCrashError(str(error), build_report(servo.memory, Cause.LINK))) from error
        report = build_report(servo.memory, cause)
        if cause >= Cause.DATA:
            raise self._latch(self._error(servo, cause, report))
        return report

    def set_payload(self, payload: Payload) -> None:
        """Set the payload at the flange in the controller.

        Args:
            payload: Mass [kg] and centre of mass [m] in the flange frame, hand and tool together.

        Raises:
            LimitError: The arm may not carry this payload.
            DeviceError: The controller does not report the payload back, or the arm is closed, busy or latched.
        """
        check_payload(payload, ARM_DATA[self._limits.model].payload)
        with self._exclusive():
            self._ask(_payload_request(payload))
            self._payload = payload

    def zero_wrench(self) -> None:
        """Zero the force reading at standstill; see `hal.Arm` and `servo.script_calls.ScriptCalls.zero_wrench`.

        Raises:
            NotReadyError: The arm moves.
            LatchedError: An earlier fault has not been reset.
            DeviceError: The force is too large for an offset, or the arm is closed or busy.
        """
        with self._exclusive():
            self._ask(ZeroWrench())

    @contextmanager
    def freedrive(self) -> Iterator[None]:
        """A context in which a person can move the arm by hand; see `hal.HandGuidedArm`."""
        with self._exclusive():
            self._ask(Freedrive(True))
            try:
                yield
            finally:
                self._ask(Freedrive(False))

    def stop(self) -> None:
        """Stop the arm on its path; callable at any time from any thread. `execute` then returns; see `hal.Arm`."""
        if self._servo is not None:
            self._servo.ask_to_stop()

    def reset(self) -> None:
        """Clear a latched fault with a new servo process and connection; does nothing where none is latched.

        The robot's old program is ended first, and the robot checked as at the start: it must be the same one, with the
        installation's payload if none was set since. TCP and the payload set last are set again and read back; the
        fault stays latched until that is done. The force reading has to be zeroed anew.

        Raises:
            NotReadyError: A person must make the robot ready first, or it is another robot.
            DeviceError: The robot does not answer or refuses the connection, or the arm is closed or busy.
            ServoCrashError: The new servo process died or hung while it connected.
        """
        with self._exclusive():
            servo = self._open()
            self._notice(servo)
            if self._fault is None:
                return
            with suppress(StaleDataError):
                status = self.state().status
                if status is not ArmStatus.READY:
                    raise NotReadyError(advice(status), code=f"not_ready.{status}")
            servo.close()
            require_ready(self._config, self._limits, self._identity, payload_set=self._payload is not None)
            servo.forget_program()
            self._servo = servo = ServoClient(self._config, self._rate)
            if self._payload is not None:
                servo.ask(_payload_request(self._payload))
            self._fault = None
            self._forget_errors()

    def _open(self) -> ServoClient:
        if self._servo is None:
            raise DeviceError("the arm is closed: use it inside its `with` block", code="device.closed")
        return self._servo

    @contextmanager
    def _exclusive(self) -> Iterator[None]:
        if not self._busy.acquire(blocking=False):
            raise DeviceError("the arm is busy with another motion, or in freedrive", code="device.busy")
        try:
            yield
        finally:
            self._busy.release()

    def _ready(self) -> ServoClient:
        """The servo process, if nothing is latched. Raises LatchedError otherwise."""
        servo = self._open()
        self._notice(servo)
        if self._fault is not None:
            raise LatchedError(f"the arm is latched since: {self._fault}")
        return servo

    def _notice(self, servo: ServoClient) -> None:
        """Latch a fault that has occurred at rest."""
        if self._fault is not None:
            return
        cause = Cause(int(servo.memory.words[Word.CAUSE]))
        if cause >= Cause.DATA:
            self._latch(self._error(servo, cause, None))
        elif not servo.alive:
            self._latch(servo.crash())
        elif not servo.cycles_within(self._config.servo.hang_timeout):
            self._latch(servo.crash(hung=True))

    def _error(self, servo: ServoClient, cause: Cause, report: MotionReport | None) -> MotionFaultError:
        # After a lost link nobody sees whether the robot's program has ended; the servo process is gone.
        ended = cause is not Cause.LINK or servo.program_ended()
        return fault(cause, self._state_now(servo), report, self._errors, program_ended=ended)

    def _latch(self, error: MotionFaultError) -> MotionFaultError:
        if self._fault is None:
            self._fault = error
        return error

    def _forget_errors(self) -> None:
        """What the controller has said so far does not explain a stop to come."""
        if self._errors is not None:
            self._errors.forget()

    def _ask(self, request: SetPayload | ZeroWrench | Freedrive) -> None:
        try:
            self._ready().ask(request)
        except ServoCrashError as error:
            raise self._latch(error) from error

    @staticmethod
    def _state_now(servo: ServoClient) -> ArmState:
        return arm_state(servo.memory.read_state())


def _payload_request(payload: Payload) -> SetPayload:
    return SetPayload(payload.mass, [float(c) for c in payload.center_of_mass])
