"""The safety system and the power of the arm: modes, stops, limits; reported by RTDE and the dashboard.

Modelled after the behaviour that Universal Robots documents, for tests of programs; it is no statement about a real
robot's safety functions.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum

import numpy as np

from toolee_robot.sim_backend.ur_controller.profile import SafetyLimits
from toolee_robot.sim_backend.ur_controller.robot.collision_detection import (
    CollisionDetection,
    Measured,
    Planned,
)
from toolee_robot.sim_backend.ur_controller.robot.error_codes import ErrorCode
from toolee_robot.sim_backend.ur_controller.robot.machine import Machine

UNLOCK_DELAY = 5.0  # [s] after a protective stop during which it cannot be unlocked, as on a real robot
SETTLE_SPEED = 1e-3  # [rad/s] below which the arm counts as standing and is powered off after an emergency stop


class RobotMode(IntEnum):
    """RTDE's robot_mode."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7


class SafetyMode(IntEnum):
    """RTDE's safety_mode."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


# bit of `safety_status_bits` of each mode; any emergency stop also sets 7, every stop sets 10
_STATUS_BIT = {mode: mode - 1 if mode < SafetyMode.VIOLATION else int(mode) for mode in SafetyMode}
_EMERGENCY = (SafetyMode.ROBOT_EMERGENCY_STOP, SafetyMode.SYSTEM_EMERGENCY_STOP)
_RUNS = (SafetyMode.NORMAL, SafetyMode.REDUCED)


class Safety:
    """Robot mode, safety mode and their transitions.

    Args:
        machine: The robot.
        limits: Limits that cause a protective stop.
        log: Called with each line of the log.
        report: Called with each error that stops the arm.
        stop_program: Ends the running program.
        pause_program: Pauses the running program; returns whether one was playing.
        resume_program: Resumes a paused program.
        power_time: Duration of powering on, and of releasing the brakes [s].

    Attributes:
        detection: Detection of collisions.
        robot_mode: Robot mode.
        mode: Safety mode.
        reason: Reason of the last stop.
        remote: Whether an e-Series controller is in remote control.
        safeguard_resumes: Whether closing the safeguard resumes the program that it paused, as on a CB3 controller
            without a safeguard reset input.
    """

    def __init__(
        self,
        machine: Machine,
        limits: SafetyLimits,
        log: Callable[[str], None],
        report: Callable[[ErrorCode], None],
        stop_program: Callable[[], None],
        pause_program: Callable[[], bool],
        resume_program: Callable[[], bool],
        power_time: float = 0.5,
    ) -> None:
        self.detection = CollisionDetection(machine.model, limits)
        self.robot_mode = RobotMode.RUNNING
        self.mode = SafetyMode.NORMAL
        self.reason = ""
        self.remote = True
        self.safeguard_resumes = machine.profile.safeguard_resumes
        self._machine, self._log, self._report, self._power_time = machine, log, report, power_time
        self._stop_program, self._pause_program, self._resume_program = stop_program, pause_program, resume_program
        self._since_stop = 0.0
        self._goal: RobotMode | None = None
        self._wait = 0.0

    @property
    def powered(self) -> bool:
        """Whether the arm is powered on."""
        return self.robot_mode >= RobotMode.POWER_ON

    @property
    def emergency(self) -> bool:
        """Whether an emergency stop is pressed."""
        return self.mode in _EMERGENCY

    @property
    def status_bits(self) -> int:
        """RTDE's safety_status_bits."""
        bits = 1 << _STATUS_BIT[self.mode]
        if self.emergency:
            bits |= 1 << 7
        if self.mode not in _RUNS:
            bits |= 1 << 10
        return bits

    def forbidden(self) -> str:
        """Why the arm must not move; empty if it may."""
        if self.mode not in _RUNS:
            return f"safety mode is {self.mode.name}"
        if self.robot_mode is not RobotMode.RUNNING:
            return f"robot mode is {self.robot_mode.name}"
        return ""

    # -- stops

    def protective_stop(self, reason: str | ErrorCode) -> None:
        """Stop and hold; the program is paused, with its motion. Unlocked through the dashboard after UNLOCK_DELAY.

        Unlocking moves nothing. Play resumes the program and its motion, from where the arm stands to the old goal
        (ur_robot_driver, `robot_state_helper`; Universal_Robots_ROS2_Driver #515).
        """
        if self.mode in _RUNS:
            self._pause_and_brake(self._machine.stops.protective)
            self._since_stop = 0.0
            if isinstance(reason, ErrorCode):
                self._report(reason)
            self._enter(SafetyMode.PROTECTIVE_STOP, str(reason))

    def emergency_stop(self, system: bool = False) -> None:
        """Press the emergency stop: the arm stops and is powered off, the program ends."""
        if not self.emergency:
            mode = SafetyMode.SYSTEM_EMERGENCY_STOP if system else SafetyMode.ROBOT_EMERGENCY_STOP
            self._stop(mode, "emergency stop pressed")

    def release_emergency_stop(self) -> None:
        """Release the emergency stop; the arm stays off until it is powered on."""
        if self.emergency:
            self._enter(SafetyMode.NORMAL, "")
            self._power(RobotMode.POWER_OFF)

    def safeguard_stop(self) -> None:
        """Open the safeguard: the program pauses, the arm stops as after a protective stop."""
        if self.mode in _RUNS:
            self._pause_and_brake(self._machine.stops.safeguard)
            self._enter(SafetyMode.SAFEGUARD_STOP, "safeguard input")

    def release_safeguard_stop(self) -> None:
        """Close and reset the safeguard; the program stays paused until it is resumed, see `safeguard_resumes`."""
        if self.mode is SafetyMode.SAFEGUARD_STOP:
            self._enter(SafetyMode.NORMAL, "")
            if self.safeguard_resumes:
                self._resume_program()

    def fault(self, violation: bool = False) -> None:
        """Enter FAULT or VIOLATION: the arm stops, and the safety system must be restarted (`restart safety`)."""
        self._stop(SafetyMode.VIOLATION if violation else SafetyMode.FAULT, "safety system")
        self._power(RobotMode.POWER_OFF)

    def unlock(self) -> str:
        """Unlock a protective stop; returns the dashboard's refusal, empty if done."""
        if self.mode is not SafetyMode.PROTECTIVE_STOP:
            return ""
        if self._since_stop < UNLOCK_DELAY:
            return (
                "Cannot unlock protective stop until 5s after occurrence. "
                "Always inspect cause of protective stop before unlocking"
            )
        self.detection.forget()
        self._enter(SafetyMode.NORMAL, "")
        return ""

    def age(self, seconds: float) -> None:
        """Increase the time since the last stop by `seconds`."""
        self._since_stop += seconds

    def restore(self) -> None:
        """Restore the initial state: normal and running."""
        self.detection.forget()
        if self.mode is not SafetyMode.NORMAL:
            self._enter(SafetyMode.NORMAL, "")
        self._power(RobotMode.RUNNING)

    def restart(self) -> None:
        """`restart safety`: leave a fault or violation; the arm is off afterwards."""
        if self.mode in (SafetyMode.FAULT, SafetyMode.VIOLATION):
            self._enter(SafetyMode.NORMAL, "")
        self._power(RobotMode.POWER_OFF)

    # -- power

    def power_on(self) -> bool:
        """Power on, to IDLE; False if the safety system forbids it."""
        return self._begin(RobotMode.IDLE)

    def brake_release(self) -> bool:
        """Release the brakes, to RUNNING, powering on first if necessary; False if the safety system forbids it."""
        return self._begin(RobotMode.RUNNING)

    def power_off(self) -> None:
        """Stop the program and power off."""
        self._stop_program()
        self._power(RobotMode.POWER_OFF)

    # -- the tick

    def step(self, dt: float, measured: Measured) -> None:
        """Check the limits after a tick.

        Args:
            dt: Length of the tick [s].
            measured: What was measured in it.
        """
        self._since_stop += dt
        self._step_power(dt)
        if self.emergency and self.powered and not np.any(np.abs(self._machine.plant.qd) > SETTLE_SPEED):
            self._power(RobotMode.POWER_OFF)
        machine = self._machine
        planned = Planned(
            machine.q_target, machine.qd_target, machine.payload, machine.sensors.dynamics, machine.uncommanded
        )
        error = self.detection.step(dt, measured, planned)
        if error is not None and self.mode in _RUNS and self.robot_mode is RobotMode.RUNNING:
            self.protective_stop(error)

    def _pause_and_brake(self, deceleration: float) -> None:
        self._pause_program()
        stop = self._machine.halt if self._machine.paused else self._machine.stop
        stop(deceleration)

    def _stop(self, mode: SafetyMode, reason: str) -> None:
        self._stop_program()
        self._machine.stop(self._machine.stops.emergency)
        self._since_stop = 0.0
        self._enter(mode, reason)

    def _enter(self, mode: SafetyMode, reason: str) -> None:
        self.mode, self.reason = mode, reason
        self._log(f"safety mode: {mode.name}" + (f" ({reason})" if reason else ""))

    def _begin(self, goal: RobotMode) -> bool:
        if self.mode not in (*_RUNS, SafetyMode.PROTECTIVE_STOP):
            return False
        if self.robot_mode < goal:
            self._goal, self._wait = goal, self._power_time
            if not self.powered:
                self._mode_is(RobotMode.POWER_ON)
        return True

    def _step_power(self, dt: float) -> None:
        if self._goal is None:
            return
        self._wait -= dt
        if self._wait > 0.0:
            return
        if self.robot_mode < RobotMode.IDLE:
            self._mode_is(RobotMode.IDLE)
        elif self._goal is RobotMode.RUNNING:
            self._mode_is(RobotMode.RUNNING)
        if self.robot_mode >= self._goal:
            self._goal = None
        else:
            self._wait = self._power_time

    def _power(self, mode: RobotMode) -> None:
        self._goal = None
        self._mode_is(mode)

    def _mode_is(self, mode: RobotMode) -> None:
        if mode is not self.robot_mode:
            self.robot_mode = mode
            self._log(f"robot mode: {mode.name}")
