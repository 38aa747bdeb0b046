"""Log of a motion of the simulated arm, and the faults that end one."""

from __future__ import annotations

import numpy as np

from toolee_robot.errors import (
    EmergencyStopError,
    LinkLostError,
    MotionFaultError,
    OverrunError,
    ProtectiveStopError,
    TrackingError,
)
from toolee_robot.frames import Array
from toolee_robot.hal import ArmStatus, MotionOutcome, MotionReport, MotionWatch
from toolee_robot.sim_backend.ur_controller.robot.error_codes import ErrorCode
from toolee_robot.types import JointState


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
