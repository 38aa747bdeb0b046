"""The controller's status numbers as `hal.ArmStatus`, advice for each, and its errors with their plain meaning.

The errors are read from the primary interface in a thread of the task's process: the controller sends an error once,
when it occurs, to who is connected then. Nothing is sent on it, and the servo process has no part in it.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Final

from toolee_robot.devices.ur.protocols.tcp import PRIMARY_PORT, ControllerError, connect, errors_in, receive
from toolee_robot.errors import DeviceError, NotReadyError
from toolee_robot.hal import ArmStatus
from toolee_robot.runtime.clock import HostClock

# RTDE's safety_status_bits.
_NORMAL_OR_REDUCED = 1 << 0 | 1 << 1
_PROTECTIVE_STOP = 1 << 2
_RECOVERY = 1 << 3
_SAFEGUARD_STOP = 1 << 4
_EMERGENCY_STOP = 1 << 5 | 1 << 6 | 1 << 7  # of the system, of the robot, of either
_FAULT = 1 << 8 | 1 << 9  # violation, fault
_STOPPED_FOR_SAFETY = 1 << 10

ROBOT_MODE_RUNNING = 7
RUNTIME_STOPPED, RUNTIME_PLAYING = 1, 2
RUNTIME_PAUSED = (3, 4, 5)
"""RTDE's runtime_state of a program that is pausing, paused, or being resumed."""
FULL_SPEED = 0.995
"""Fraction of the commanded speed from which on a motion counts as executed at it."""

_ADVICE = {
    ArmStatus.PROTECTIVE_STOP: "the robot made a protective stop: find out why, release it at the robot, then reset",
    ArmStatus.SAFEGUARD_STOP: "the safeguard stop is open: close it and reset it at the robot, then reset",
    ArmStatus.EMERGENCY_STOP: "the emergency stop is pressed: release it, switch the robot on again, then reset",
    ArmStatus.FAULT: "the robot reports a safety violation or fault: see its pendant, then reset",
    ArmStatus.NOT_READY: "the robot is not in its running mode: switch it on and release the brakes, then reset",
}


def arm_status(safety_bits: int, robot_mode: int) -> ArmStatus:
    """Convert RTDE's status numbers.

    Args:
        safety_bits: RTDE's safety_status_bits.
        robot_mode: RTDE's robot_mode.

    Returns:
        The most severe status that applies.
    """
    if safety_bits & _FAULT:
        return ArmStatus.FAULT
    if safety_bits & _EMERGENCY_STOP:
        return ArmStatus.EMERGENCY_STOP
    if safety_bits & _PROTECTIVE_STOP:
        return ArmStatus.PROTECTIVE_STOP
    if safety_bits & (_SAFEGUARD_STOP | _STOPPED_FOR_SAFETY):
        return ArmStatus.SAFEGUARD_STOP
    moves = safety_bits & _NORMAL_OR_REDUCED and not safety_bits & _RECOVERY
    if not moves or robot_mode != ROBOT_MODE_RUNNING:
        return ArmStatus.NOT_READY
    return ArmStatus.READY


def advice(status: ArmStatus) -> str:
    """What has happened and what a person must do, for every status but READY."""
    return _ADVICE[status]


def check_speed_slider(fraction: float) -> None:
    """Check that the speed slider is at its end, since motions are timed for it.

    Args:
        fraction: Position of the slider, 0 to 1.

    Raises:
        NotReadyError: It is not; code `not_ready.speed_slider`.
    """
    if not fraction >= FULL_SPEED:
        message = f"the speed slider is at {fraction:.0%}: set it to 100 % at the pendant, motions are timed for it"
        raise NotReadyError(message, code="not_ready.speed_slider")


JOINTS = ("the base", "the shoulder", "the elbow", "wrist 1", "wrist 2", "wrist 3")

_HIT = "it was hit, or the motion was too fast for the payload that is set"
_NO_PAYLOAD = "no payload is set: set it"
_LIMIT = "slow the motion down, or see the robot's safety configuration"


@dataclass(frozen=True)
class _Meaning:
    """Meaning of a code.

    Attributes:
        kind: Last part of the code of the driver's error.
        text: What has happened; `{joint}` stands for the argument's joint.
        remedy: What to look at, or to change.
    """

    kind: str
    text: str
    remedy: str


_CODES = {
    153: _Meaning("position_deviation", "{joint} was off its path", _HIT),
    159: _Meaning("position_deviation", "{joint} was off its path", _NO_PAYLOAD),
    157: _Meaning("collision", "{joint} detected a collision", _HIT),
    158: _Meaning("collision", "{joint} detected a collision", _NO_PAYLOAD),
    173: _Meaning(
        "torque",
        "the motion takes more torque than {joint} has",
        "slow it down, move the work nearer to the arm, or check the payload that is set",
    ),
    174: _Meaning(
        "torque_jump",
        "the motion changes the torque of {joint} too suddenly",
        "lower acceleration and jerk, or check the payload that is set",
    ),
}
_WITH_ARGUMENT = {
    (191, 1): _Meaning("safety_limit", "a joint passed its position limit", "see the robot's safety configuration"),
    (191, 2): _Meaning("safety_limit", "a joint passed its speed limit", _LIMIT),
    (191, 3): _Meaning("safety_limit", "the TCP passed its speed limit", _LIMIT),
    (191, 6): _Meaning("safety_limit", "the arm passed its power limit", _LIMIT),
    (191, 7): _Meaning("safety_limit", "a force or torque passed its limit", "see what the arm has touched"),
    (191, 12): _Meaning("safety_limit", "the arm passed its momentum limit", _LIMIT),
    (204, 1): _Meaning("path", "a commanded position jumped", "see why, in the log of the motion"),
    (204, 3): _Meaning("path", "the commands ended while the arm moved", "see whether this computer was too slow"),
}


def explain(error: ControllerError) -> tuple[str, str]:
    """Explain an error of the controller.

    Args:
        error: The error.

    Returns:
        A clause for a message, which names the code; and the kind of the error, empty where the code is not known here.
    """
    meaning = _WITH_ARGUMENT.get((error.code, error.argument), _CODES.get(error.code))
    if meaning is None:
        said = f', "{error.text}"' if error.text else ""
        return f"{error.name}{said} (see the robot's log, and Universal Robots' directory of error codes)", ""
    joint = JOINTS[error.argument] if 0 <= error.argument < len(JOINTS) else "the arm"
    return f"{error.name}: {meaning.text.format(joint=joint)}; {meaning.remedy}", meaning.kind


TIMEOUT: Final = 1.0
"""[s] of a connection, and of silence on it: the controller sends its state ten times a second."""
RETRY: Final = 1.0  # [s] between two connections
WAIT: Final = 0.3
"""[s] Longest wait for the error that explains a stop: the controller's period here is 0.1 s."""


class ErrorLog:
    """The errors since the last `forget`. Where the port is closed there are none, and `why_empty` says so.

    Args:
        host: Address of the controller.
        clock: The station's clock.
    """

    def __init__(self, host: str, clock: HostClock) -> None:
        self._host, self._clock = host, clock
        self._changed = threading.Condition()
        self._errors: list[ControllerError] = []
        self._failure = f"port {PRIMARY_PORT} has not answered yet"
        self._closed = threading.Event()
        threading.Thread(target=self._run, name="arm error log", daemon=True).start()

    def close(self) -> None:
        """End the connection; the thread ends within TIMEOUT."""
        self._closed.set()

    def forget(self) -> None:
        """Forget all errors: those to come belong to what begins now."""
        with self._changed:
            self._errors.clear()

    def reason(self) -> ControllerError | None:
        """The error that explains a stop: of the most severe ones the first, since what follows are consequences.

        Waits up to WAIT on the station's clock for one to arrive, but not where there is no connection.

        Returns:
            The error; None where the controller has sent none.
        """
        deadline = time.monotonic() + self._clock.to_wall_time(WAIT)
        with self._changed:
            while not self._errors and not self._failure and (left := deadline - time.monotonic()) > 0.0:
                self._changed.wait(left)
            return self._most_severe()

    def told(self) -> ControllerError | None:
        """What `reason` returns, without a wait."""
        with self._changed:
            return self._most_severe()

    @property
    def why_empty(self) -> str:
        """Why there may be no errors, a clause for a message."""
        return self._failure or f"it sent none on port {PRIMARY_PORT}"

    def _most_severe(self) -> ControllerError | None:
        return max(self._errors, key=lambda error: error.level, default=None)

    def _run(self) -> None:
        timeout, retry = (self._clock.to_wall_time(seconds) for seconds in (TIMEOUT, RETRY))
        while not self._closed.is_set():
            try:
                self._read(timeout)
            except DeviceError as error:
                self._fails(f"no messages come from its port {PRIMARY_PORT} ({error})")
            self._closed.wait(retry)

    def _read(self, timeout: float) -> None:
        with connect(self._host, PRIMARY_PORT, time.monotonic() + timeout) as sock:
            buffer = bytearray()
            while not self._closed.is_set():
                buffer += receive(sock, time.monotonic() + timeout)
                if errors := [error for error in errors_in(buffer) if error.serious]:
                    with self._changed:
                        self._errors += errors
                        self._changed.notify_all()
                if self._failure:
                    self._fails("")

    def _fails(self, why: str) -> None:
        with self._changed:
            self._failure = why
            self._changed.notify_all()
