"""The simulated arm: position commands at the controller's rate, force sensing at the flange, path stop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

import numpy as np

from toolee_robot.arm_data import ARM_DATA, CB3_RATE
from toolee_robot.control.motion.contact_force import ContactForce
from toolee_robot.control.motion.path_stop import stop_on_path
from toolee_robot.control.motion.trajectory_checks import check_payload, check_trajectory
from toolee_robot.errors import (
    DeviceError,
    EmergencyStopError,
    LatchedError,
    LinkLostError,
    MotionFaultError,
    NotReadyError,
    OverrunError,
    ProtectiveStopError,
    StaleDataError,
    TrackingError,
)
from toolee_robot.frames import Array
from toolee_robot.hal import ArmState, ArmStatus, ContactGuard, MotionOutcome, MotionReport, MotionWatch
from toolee_robot.sim_backend.devices.flange_sensor import FlangeSensor, OwnStops, ReadingErrors
from toolee_robot.sim_backend.ur_controller.robot.error_codes import ErrorCode
from toolee_robot.sim_backend.world import SimWorld
from toolee_robot.types import JointState, Payload, Trajectory


class MotionLog:
    """What was sent and measured in a motion.

    Args:
        rate: Rate of the commands [Hz].

    Attributes:
        rate: Rate of the commands [Hz].
        stamps: Times of the rows [s].
        commanded: Commanded joint positions, (6,) [rad] each.
        measured: Measured joint positions, (6,) [rad] each.
        velocities: Measured joint velocities, (6,) [rad/s] each.
        wrenches: Wrenches, (6,) [N, Nm] each.
        torques: Joint torques of the commanded motion, (6,) [Nm] each; none of an arm that has none.
        ratios: Deviation and collision ratios, each sample's; none of an arm that does not report them.
        commands: Number of rows with a command of its own; None while every row has one.
        late: Number of late commands.
        late_in_a_row: Number of consecutive late commands up to the newest.
    """

    def __init__(self, rate: float) -> None:
        self.rate = rate
        self.stamps: list[float] = []
        self.commanded: list[Array] = []
        self.measured: list[Array] = []
        self.velocities: list[Array] = []
        self.wrenches: list[Array] = []
        self.torques: list[Array] = []
        self.ratios: list[tuple[float, float]] = []
        self.commands: int | None = None
        self.late, self.late_in_a_row = 0, 0

    def add(
        self,
        stamp: float,
        commanded: Array,
        measured: JointState,
        wrench: Array,
        torques: Array | None = None,
        ratios: tuple[float, float] | None = None,
    ) -> None:
        """Append a row.

        Args:
            stamp: Time [s].
            commanded: Commanded joint positions, (6,) [rad].
            measured: Measured state of the joints.
            wrench: Wrench, (6,) [N, Nm].
            torques: Joint torques of the commanded motion, (6,) [Nm]; None of an arm that has none.
            ratios: Deviation and collision ratios, see `ArmState`; None of an arm that does not report them.
        """
        self.stamps.append(stamp)
        self.commanded.append(commanded.copy())
        self.measured.append(measured.q)
        self.velocities.append(measured.qd)
        self.wrenches.append(wrench)
        if torques is not None:
            self.torques.append(torques)
        if ratios is not None:
            self.ratios.append(ratios)

    def end_commands(self) -> None:
        """Note that no row from now on has a command."""
        self.commands = len(self.stamps)

    def count(self, late: bool) -> None:
        """Count a command, and whether it was sent late."""
        self.late += late
        self.late_in_a_row = self.late_in_a_row + 1 if late else 0

    def report(self, outcome: MotionOutcome, contact: JointState | None) -> MotionReport:
        """Build the motion's report.

        Args:
            outcome: How the motion ended.
            contact: Measured state at the contact, if there was one.

        Returns:
            The report.
        """
        stamps, commanded, measured, wrenches = map(
            np.array, (self.stamps, self.commanded, self.measured, self.wrenches)
        )
        ratios = np.array(self.ratios) if self.ratios else None
        return MotionReport(
            outcome,
            stamps,
            commanded,
            measured,
            wrenches,
            contact,
            self.late,
            position_deviation_ratios=None if ratios is None else ratios[:, 0],
            collision_ratios=None if ratios is None else ratios[:, 1],
            commands=self.commands,
            qd_measured=np.array(self.velocities),
            torques=np.array(self.torques) if self.torques else None,
        )


# Class and message of the error.
Fault = tuple[type[MotionFaultError], str]


def motion_fault(
    status: ArmStatus, age: float, watch: MotionWatch, log: MotionLog, found: ErrorCode | None = None
) -> Fault | None:
    """The fault that must end the motion now, if any.

    Args:
        status: State of the robot's safety system.
        age: Age of the newest state [s].
        watch: Bounds of the motion.
        log: The motion so far.
        found: The error for which the robot has stopped itself, where it has.

    Returns:
        Class and message of the error; None without a fault.
    """
    if status is ArmStatus.EMERGENCY_STOP:
        return EmergencyStopError, "the emergency stop was pressed: release it at the robot"
    if status is ArmStatus.PROTECTIVE_STOP and found is not None:
        return ProtectiveStopError, f"the robot made a protective stop: {found}: find out why, release it at the robot"
    if status is not ArmStatus.READY:
        return ProtectiveStopError, f"the robot stopped itself ({status}). Find out why, then release it at the robot"
    if age > watch.data_cycles / log.rate + 1e-9:
        return LinkLostError, f"no data from the arm for {age * 1e3:.0f} ms: check its network link"
    # An old reading says nothing about the current tracking error.
    error = np.abs(log.measured[-1] - log.commanded[-1]) if age == 0.0 else np.zeros(6)
    if error.max() > watch.tracking_error:
        joint = int(error.argmax())
        return TrackingError, f"joint {joint + 1} is {error[joint]:.3f} rad away from its command"
    if log.late_in_a_row > watch.overruns:
        return OverrunError, f"{log.late_in_a_row} commands in a row were sent late: reduce the load on this machine"
    return None


RATE = CB3_RATE
STANDSTILL = 1e-2
"""[rad/s] Joint speed below which a joint counts as standing, as in the driver of real arms."""
HOLD_TIME = 0.1
"""[s] Time at standstill before a motion ends, as in that driver: a ringing arm stands at each turning point."""
SETTLE_TIME = 1.0  # [s] longest wait for standstill after the last command
AT_REST = 0.02  # [rad/s] joint speed below which the force can be zeroed
LATE = 0.6  # delay of an injected late command, as a fraction of the cycle


class SimArm:
    """A `hal.Arm` that moves the simulated UR10.

    It stops by itself where the controller stand-in would (`OwnStops`): it brakes as that does, and is latched until a
    person has made it ready. Faults can be injected with `cut_link`, `protective_stop`, `emergency_stop`,
    `block_joint` and `delay_commands`; `make_ready` and `restore_link` undo them, as a person does at the robot.

    Args:
        world: The simulated world.
        wrench_errors: Size of the errors of the wrench as a share of those of the arm's generation (`ReadingErrors`),
            whose limits of the protective stops the arm then has; 0 for an exact reading and the limits of `ideal`.
        seed: Seed of these errors.
    """

    def __init__(self, world: SimWorld, wrench_errors: float = 0.0, seed: int | Sequence[int] = 0) -> None:
        self._world = world
        robot = world.robot.robot
        self._lower, self._upper = robot.lower[:6], robot.upper[:6]
        self._limits = world.config.arm
        self._velocity = np.minimum(np.array(self._limits.velocity), robot.velocity[:6])
        errors = None if wrench_errors <= 0.0 else ReadingErrors(self._limits.model, wrench_errors, seed, 1 / RATE)
        self._q = world.robot.q_arm_target.copy()
        self._stops = OwnStops(self._limits.model, errors, self._q, 1 / RATE)
        self._sensor = FlangeSensor(world, robot.hand_payload(robot.hand_open), 1 / RATE, errors)
        self._sensor.q_target, self._sensor.watch = lambda: self._stops.q_before, self._check
        world.wrench = lambda: self._sensor.wrench.copy()
        self._open, self._moving, self._stop_asked = True, False, False
        self._status, self._latched = ArmStatus.READY, ""
        self._stopped_by: ErrorCode | None = None  # since the last motion began
        self._stuck: dict[int, float] = {}
        self._late, self._since = 0, 0.0
        self._last: ArmState | None = None  # the last state received, while the link is down

    def __enter__(self) -> Self:
        self._open = True
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._open = False

    @property
    def rate(self) -> float:
        """Rate of the commands [Hz]."""
        return RATE

    @property
    def q_commanded(self) -> Array:
        """Commanded joint positions, (6,) [rad]; available while the link is down as well."""
        return self._q.copy()

    def state(self, max_age: float = 0.1) -> ArmState:
        """The current state.

        Args:
            max_age: Largest accepted age [s].

        Returns:
            The state; the last one received while the link is down.

        Raises:
            StaleDataError: The link has been down for longer than `max_age`.
            DeviceError: The arm is closed.
        """
        self._check_open()
        if self._last is None:
            return self._read()
        age = self._world.time - self._last.joints.stamp
        if age > max_age:
            message = f"the arm's newest state is {age:.2f} s old: check its network link, then start again"
            raise StaleDataError(message, code="stale_data.arm")
        return self._last

    def _read(self) -> ArmState:
        q, qd = self._world.robot.arm_state()
        deviation, collision = self._stops.ratios or (None, None)
        return ArmState(
            JointState(q, qd, self._world.time),
            self._q.copy(),
            self._sensor.wrench.copy(),
            self._status,
            position_deviation_ratio=deviation,
            collision_ratio=collision,
            error_code=None if self._stopped_by is None else self._stopped_by.name,
        )

    def _check(self, q: Array, qd: Array) -> None:
        """Stop the arm where its controller would, after each reading of the force."""
        sensor = self._sensor
        found = self._stops.check(sensor.wrench + sensor.offset, q, qd, sensor.payload.mass)
        if found is not None and self._status is ArmStatus.READY:
            self._status, self._stopped_by = ArmStatus.PROTECTIVE_STOP, found
            self._latched = self._latched or f"the robot made a protective stop: {found}"

    def _newest(self) -> ArmState:
        return self._read() if self._last is None else self._last

    def cut_link(self) -> None:
        """Fault: the arm's states do not arrive, as with an unplugged network cable."""
        self._last = self._read()

    def restore_link(self) -> None:
        """Undo `cut_link`."""
        self._last = None

    def protective_stop(self) -> None:
        """Fault: the robot makes a protective stop."""
        self._status = ArmStatus.PROTECTIVE_STOP
        self._latched = self._latched or "the robot made a protective stop"

    def emergency_stop(self) -> None:
        """Fault: a person presses the emergency stop."""
        self._status = ArmStatus.EMERGENCY_STOP
        self._latched = self._latched or "the emergency stop was pressed"

    def safeguard_stop(self) -> None:
        """Fault: the safeguard opens, as by a door."""
        self._status = ArmStatus.SAFEGUARD_STOP
        self._latched = self._latched or "the safeguard stop is open"

    def make_ready(self) -> None:
        """Act as the person at the robot: release stops, free blocked joints, enable the robot."""
        self._status = ArmStatus.READY
        self._stops.forget()
        self._stuck.clear()
        self._late = 0

    def block_joint(self, joint: int) -> None:
        """Fault: a joint (0 to 5) is blocked at its current position."""
        self._stuck[joint] = float(self._world.robot.arm_state()[0][joint])

    def delay_commands(self, cycles: int) -> None:
        """Fault: the next `cycles` commands are sent late."""
        self._late = cycles

    def set_payload(self, payload: Payload) -> None:
        """Set the payload at the flange, hand and tool, which the force sensor compensates.

        Args:
            payload: Mass [kg] and centre of mass [m] in the flange frame.

        Raises:
            LimitError: The arm may not carry this payload.
            LatchedError: A fault has not been reset.
        """
        self._check_latch()
        check_payload(payload, ARM_DATA[self._limits.model].payload)
        self._sensor.payload = payload
        self._world.robot.set_payload(payload)

    def zero_wrench(self) -> None:
        """Zero the force reading by its mean over half a second, which passes; see `hal.Arm`.

        Raises:
            NotReadyError: The arm moves.
            LatchedError: An earlier fault has not been reset.
            DeviceError: The force is too large for an offset, the link is down, or the arm is closed.
        """
        self._check_open()
        self._check_latch()
        if self._last is not None:
            raise DeviceError("the arm does not answer: check its network link")
        if (fastest := np.abs(self._world.robot.arm_state()[1]).max()) > AT_REST:
            message = f"the arm moves ({fastest:.2f} rad/s): the force can be zeroed at standstill only"
            raise NotReadyError(message, code="not_ready.moving")
        self._sensor.zero()

    def execute(
        self, trajectory: Trajectory, guard: ContactGuard | None = None, watch: MotionWatch | None = None
    ) -> MotionReport:
        """Execute a trajectory and block until standstill; see `hal.Arm`.

        Args:
            trajectory: Joint trajectory that starts at the state's `q_commanded`.
            guard: Contact at which to stop; None for no contact detection.
            watch: Bounds checked in every cycle; the defaults of `MotionWatch` if None.

        Returns:
            What was sent and measured, one row per command cycle.

        Raises:
            LimitError: The trajectory breaks a limit; nothing was moved.
            LatchedError: An earlier fault has not been reset; nothing was moved.
            MotionFaultError: A fault stopped the arm; it is latched from now on.
            DeviceError: The arm is closed.
        """
        self._check_open()
        self._check_latch()
        check_trajectory(trajectory, self._q, self._lower, self._upper, self._velocity)
        watch = MotionWatch() if watch is None else watch
        log = MotionLog(RATE)
        contact: JointState | None = None
        force = None if guard is None else ContactForce(guard, 1 / RATE)
        outcome, fault = MotionOutcome.COMPLETED, None
        self._stop_asked, self._moving, self._stopped_by = False, True, None
        t = 0.0
        try:
            for k in range(1, int(np.ceil(trajectory.duration * RATE - 1e-9)) + 1):
                t = min(k / RATE, trajectory.duration)
                self._command(trajectory.sample(t)[0], log)
                self._tick(log)
                fault = self._fault(watch, log)
                if fault is not None or self._stop_asked:
                    outcome = MotionOutcome.STOPPED
                    break
                if force is not None and force.add(log.wrenches[-1][:3], t):
                    outcome = MotionOutcome.CONTACT
                    contact = JointState(*self._world.robot.arm_state(), self._world.time)
                    break
        finally:
            # After an exception too, the arm must come to rest before this returns.
            self._brake(trajectory, t, log)
            self._moving = False
        # A motion that ended for another reason, such as a contact, may have a tracking error as well; and the robot
        # may have stopped itself meanwhile.
        if fault is None or self._stopped_by is not None:
            fault = self._fault(watch, log)
        report = log.report(outcome, contact)
        if fault is not None:
            error, message = fault
            self._latched = self._latched or message
            where = " on its path" if self._stopped_by is None else ""
            raise error(f"{message}; the arm has stopped{where} and is latched", report)
        return report

    def _fault(self, watch: MotionWatch, log: MotionLog) -> Fault | None:
        """The fault that must end the motion now, if any."""
        age = 0.0 if self._last is None else self._world.time - self._last.joints.stamp
        return motion_fault(self._status, age, watch, log, self._stopped_by)

    def stop(self) -> None:
        """Stop on the path; called from a callback during `execute`, it ends that motion."""
        if self._moving:
            self._stop_asked = True

    def reset(self) -> None:
        """Clear a latched fault; the arm then holds its current position.

        Raises:
            DeviceError: A person must make the robot ready first, or the link is down.
        """
        self._check_open()
        if self._status is not ArmStatus.READY:
            found = self._stopped_by if self._status is ArmStatus.PROTECTIVE_STOP else None
            status = self._status.replace("_", " ") + ("" if found is None else f" ({found})")
            message = f"the robot is in {status}: a person must make it ready at the robot"
            raise DeviceError(message, code="device.robot_status")
        if self._last is not None:
            raise DeviceError("the arm does not answer: check its network link")
        self._latched = ""
        self._q = self._world.robot.arm_state()[0]
        self._stops.place(self._q)
        self._world.robot.command_arm(self._q, np.zeros(6))

    def _check_latch(self) -> None:
        if self._latched:
            raise LatchedError(f"{self._latched}: nothing moves until a person has checked and reset the arm")

    def _check_open(self) -> None:
        if not self._open:
            raise DeviceError("the arm is closed: use it inside its `with` block", code="device.closed")

    def _command(self, q: Array, log: MotionLog) -> None:
        """Command the position due at the end of the tick; the robot moves to it at the tick's mean velocity."""
        late = self._late > 0
        self._since = LATE / RATE if late else 0.0
        log.count(late)
        if late:
            self._late -= 1
            self._sensor.begin()
            self._world.advance(self._since)  # with the previous command
        self._q = np.array(q)
        self._move(self._q)

    def _move(self, q: Array) -> None:
        """Move the set-point to q, (6,) [rad], within the tick."""
        target = self._stops.q_target.copy()
        step = (q - target) * RATE
        for joint, place in self._stuck.items():
            target[joint], step[joint] = place, 0.0
        self._world.robot.command_arm(target + self._since * step, step)
        self._stops.move(q)

    def _tick(self, log: MotionLog) -> None:
        if self._since == 0.0:
            self._sensor.begin()
        self._world.advance(1 / RATE - self._since)
        self._since = 0.0
        newest = self._newest()
        torques = self._world.robot.torques_commanded
        log.add(self._world.time, self._q, newest.joints, newest.wrench, torques, self._stops.ratios)

    def _brake(self, trajectory: Trajectory, t: float, log: MotionLog) -> None:
        """Stop on the trajectory's path, from its time t [s] on, or as the robot stops itself; wait for standstill."""
        limits = self._limits
        for q, _ in stop_on_path(trajectory, t, 1 / RATE, limits.stop_acceleration, limits.stop_jerk):
            if self._stopped_by is not None:
                break
            self._command(q, log)
            self._tick(log)
        if self._stopped_by is None:
            self._command(self._q, log)
        else:
            log.end_commands()
            for q in self._stops.braking():
                self._move(q)
                self._tick(log)
        still = 0
        for _ in range(int(SETTLE_TIME * RATE)):
            self._tick(log)
            still = still + 1 if np.abs(self._world.robot.arm_state()[1]).max() < STANDSTILL else 0
            if still >= HOLD_TIME * RATE:
                break
