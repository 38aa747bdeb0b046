"""The arm: its state, the records of a motion, and its Protocol."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array
from toolee_robot.hal.device import Device
from toolee_robot.types import JointState, Payload, Trajectory

ZERO_TIME = 0.5
"""Time over which the force reading at rest is averaged to zero it [s]: 62 readings of a CB3, 250 of an e-Series, so
that a noise of 3.6 N leaves 0.5 N and 0.2 N where it is not correlated."""


class ArmStatus(StrEnum):
    """State of the robot's own safety system.

    The arm moves only in READY; every other state needs a person at the robot.
    """

    READY = "ready"
    PROTECTIVE_STOP = "protective_stop"
    SAFEGUARD_STOP = "safeguard_stop"
    EMERGENCY_STOP = "emergency_stop"
    FAULT = "fault"
    NOT_READY = "not_ready"


@dataclass(frozen=True)
class ArmState:
    """State of the arm at one time.

    Attributes:
        joints: Measured state of the 6 joints.
        q_commanded: Joint positions that the arm holds, (6,) [rad]: those commanded last or, before the first command,
            after a reset and after a move by hand, those where the arm came to rest. The next motion starts there.
        wrench: Force [N] and torque [Nm] that the environment exerts on the flange, (6,), `base` axes, with weight and
            inertia of the payload compensated as far as the arm can.
        status: State of the robot's own safety system.
        position_deviation_ratio: How near the joints' deviation from their path is to a protective stop, which comes at
            1; None where the controller does not report it.
        collision_ratio: How near the robot's collision detection is to a protective stop, which comes at 1; None
            likewise.
        digital_inputs: The robot's digital inputs, one bit each, as the controller numbers them; 0 for an arm without.
        safety_bits: The controller's own safety status, as it numbers the bits (RTDE: safety_status_bits); None for an
            arm without.
        error_code: Code that explains the robot's last stop, as its controller names it, such as C157A4; None where it
            has sent none since the last motion began.

    Two states with the same stamp are the same reading.
    """

    joints: JointState
    q_commanded: Array
    wrench: Array
    status: ArmStatus = ArmStatus.READY
    position_deviation_ratio: float | None = None
    collision_ratio: float | None = None
    digital_inputs: int = 0
    safety_bits: int | None = None
    error_code: str | None = None


@dataclass(frozen=True)
class ContactGuard:
    """Contact detection during a motion.

    On contact the arm brakes along its path from the last commanded state as fast as its limits allow, and the motion
    ends.

    Attributes:
        force: Payload-compensated force at the flange that counts as contact [N].
        ignore_before: Time on the trajectory before which no force counts, because of starting transients [s].
        averaging_window: Time over which the force vector is averaged [s]; a single reading if shorter than the cycle.
            Vibration (a late command, a swinging tool) changes sign and averages out, an obstacle does not.
        baseline: Time before that window whose mean force is subtracted [s], so that only a rise within it counts and
            not an offset that changes slowly; 0 for the absolute force.
        sway: What the motion itself adds to the force from `sway_from` to `sway_until`, and is no contact [N].
        sway_from: Time on the trajectory [s].
        sway_until: Time on the trajectory [s].
    """

    force: float
    ignore_before: float = 0.0
    averaging_window: float = 0.0
    baseline: float = 0.0
    sway: float = 0.0
    sway_from: float = 0.0
    sway_until: float = 0.0


@dataclass(frozen=True)
class MotionWatch:
    """Bounds that the arm's driver checks in every cycle of a motion.

    On a violation the arm brakes along its path from the last commanded state, latches, and raises.

    Attributes:
        tracking_error: Largest deviation of a measured joint from its command, less the servo's known lag [rad].
        data_cycles: Largest age of the newest reading [control cycles].
        overruns: Largest number of successive command cycles that are late by half a cycle or more.
    """

    tracking_error: float = 0.05
    data_cycles: float = 3.0
    overruns: int = 3


class MotionOutcome(StrEnum):
    """How a motion ended: completed, at a contact, or stopped (by a fault, a person or `stop()`)."""

    COMPLETED = "completed"
    CONTACT = "contact"
    STOPPED = "stopped"


@dataclass(frozen=True)
class MotionReport:
    """Commanded and measured course of a motion.

    Attributes:
        outcome: How the motion ended.
        stamps: Times of the samples, (N,) [s].
        q_commanded: Commanded joint positions, (N, 6) [rad]. From `commands` on nothing was commanded, and the last
            command is repeated.
        q_measured: Measured joint positions, (N, 6) [rad].
        wrenches: Wrench on the flange, (N, 6) [N, Nm], `base` axes; of several readings between two stamps the one with
            the greatest force.
        contact: Measured state when the guard first detected the contact, or None.
        overruns: Number of command cycles that were late by half a cycle or more.
        position_deviation_ratios: See `ArmState`, (N,), each sample's largest; None where the controller does not
            report it.
        collision_ratios: See `ArmState`, (N,), likewise.
        commands: Number of commands that were sent, at most N: a robot that has stopped by itself is sent none. None
            where every sample has one.
        lateness: Largest delay of a command behind its cycle [s].
        data_age: Largest age of the newest reading when a command was sent [s].
        qd_measured: Measured joint velocities, (N, 6) [rad/s]; None where the arm does not report them.
        torques: Joint torques of the commanded motion, gravity included, as the controller computes them from its links
            and the payload it was told (RTDE: target_moment), (N, 6) [Nm]: no measurement. None likewise.
        currents: Measured motor currents, (N, 6) [A]; None likewise.
        safety_bits: See `ArmState`, (N,) integers; None likewise.
    """

    outcome: MotionOutcome
    stamps: Array
    q_commanded: Array
    q_measured: Array
    wrenches: Array
    contact: JointState | None = None
    overruns: int = 0
    position_deviation_ratios: Array | None = None
    collision_ratios: Array | None = None
    commands: int | None = None
    lateness: float = 0.0
    data_age: float = 0.0
    qd_measured: Array | None = None
    torques: Array | None = None
    currents: Array | None = None
    safety_bits: NDArray[np.int64] | None = None


@runtime_checkable
class Arm(Device, Protocol):
    """A position-controlled arm with six joints.

    Any end of a motion other than completion, a contact or `stop` is a fault: the arm stands still, latches, and raises
    a `MotionFaultError` that carries the report of the motion so far. While the arm is latched, `execute` raises
    `LatchedError` and nothing moves.
    """

    @property
    def rate(self) -> float:
        """Command rate [Hz]; commands are sent on an absolute schedule."""

    def state(self, max_age: float = 0.1) -> ArmState:
        """Return the newest state.

        Args:
            max_age: Largest age of the reading [s].

        Raises:
            StaleDataError: The newest reading is older than `max_age`.
            DeviceError: The arm does not answer.
        """

    def execute(
        self, trajectory: Trajectory, guard: ContactGuard | None = None, watch: MotionWatch | None = None
    ) -> MotionReport:
        """Execute a trajectory and block until standstill.

        An arm checks its own limits only; what it may hit and who is near, `control.Supervisor` checks, which calls
        this.

        Args:
            trajectory: Motion of the 6 joints from rest to rest. Its first sample must equal the state's `q_commanded`
                within `motion.trajectory_checks.START_TOLERANCE`.
            guard: Contact detection; None for none.
            watch: Bounds checked in every cycle; None for the arm's own.

        Returns:
            What was sent and measured.

        Raises:
            LimitError: The trajectory violates a limit or starts elsewhere; nothing moves.
            LatchedError: A fault has not been reset; nothing moves.
            MotionFaultError: A fault ended the motion; the arm stands still and is latched.
        """

    def set_payload(self, payload: Payload) -> None:
        """Tell the arm what its flange carries.

        Args:
            payload: Mass [kg] and centre of mass [m], flange frame.

        Raises:
            LimitError: The arm cannot carry it.
        """

    def zero_wrench(self) -> None:
        """Zero the force reading of an arm that stands still and touches nothing, for all readings to come.

        What is subtracted is the mean over ZERO_TIME. An offset that changes with the pose is gone near this pose only,
        and a new payload brings a new one. A reset may undo it.

        Raises:
            NotReadyError: The arm moves.
            LatchedError: A fault has not been reset.
            DeviceError: The force is too large for an offset, or the arm cannot zero it.
        """

    def stop(self) -> None:
        """Bring the arm to a standstill as fast as its limits allow, from the last commanded state.

        May be called at any time, from any thread.
        """

    def reset(self) -> None:
        """Clear the latch after a person has made the robot ready again.

        Reconnects if necessary. Never clears a protective stop or an emergency stop.

        Raises:
            DeviceError: The robot is not ready.
        """


@runtime_checkable
class HandGuidedArm(Arm, Protocol):
    """An arm that a person can move by hand."""

    def freedrive(self) -> AbstractContextManager[None]:
        """A context inside which a person can move the arm by hand; afterwards it holds its position.

        Raises:
            LatchedError: A fault has not been reset.
            DeviceError: The arm refuses.
        """
