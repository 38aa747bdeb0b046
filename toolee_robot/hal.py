"""The hardware abstraction: what an arm, a hand, a camera, a person and a clock promise to a task.

The same Protocols stand for the simulation, for controller stand-ins and for real devices. They carry no ground
truth. SI units, radians. All stamps are seconds on the station's clock. Devices are context managers; leaving the
context brings the device to a safe standstill. A device that is unsure stands still and raises `DeviceError`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from toolee_robot.frames import Array
from toolee_robot.types import CameraIntrinsics, JointState, Payload, RgbdFrame, Trajectory


class Device(Protocol):
    """Anything that is opened, used and left in a safe state."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class ArmStatus(StrEnum):
    """What the robot's own safety system says. Only READY moves; everything else needs a person at the robot."""

    READY = "ready"
    PROTECTIVE_STOP = "protective_stop"
    SAFEGUARD_STOP = "safeguard_stop"
    EMERGENCY_STOP = "emergency_stop"
    FAULT = "fault"
    NOT_READY = "not_ready"


@dataclass(frozen=True)
class ArmState:
    """joints: 6 joints, measured. q_commanded: (6,) [rad] the position that the arm holds: commanded last, or, before
    anything was and after a reset or a hand has moved it, where it came to rest; the next motion starts there. wrench:
    (6,) force [N] and torque [Nm] that the environment puts on the flange, base axes, payload's weight and inertia
    compensated as well as the arm can. status: of the robot's own safety system."""

    joints: JointState
    q_commanded: Array
    wrench: Array
    status: ArmStatus = ArmStatus.READY


@dataclass(frozen=True)
class ContactGuard:
    """Watch for contact during a motion.

    force: sensed force [N] at the flange (payload-compensated) that counts as contact. ignore_before: time [s] on the
    trajectory before which nothing counts (starting transients). averaging_window: time [s] over which the force is
    averaged, as a vector, or one reading if shorter: what only shakes the arm (a late command, a tool that swings)
    comes and goes with changing sign, what is in its way stays. On contact the arm brakes along the path from its last
    commanded state as fast as its limits allow, and the motion ends."""

    force: float
    ignore_before: float = 0.0
    averaging_window: float = 0.0


@dataclass(frozen=True)
class MotionWatch:
    """Bounds that the arm itself checks in every cycle of a motion, next to the robot; on a breach it brakes along the
    path from its last commanded state, latches, and raises.

    tracking_error: the most that a measured joint may be away from its command, the servo's known lag taken off [rad].
    data_cycles: the most cycles for which the newest reading may be old. overruns: the most command cycles in a row
    that may be late by half a cycle or more.
    """

    tracking_error: float = 0.05
    data_cycles: float = 3.0
    overruns: int = 3


class MotionOutcome(StrEnum):
    """How a motion ended: as planned, at a contact, or stopped (a fault, a person, `stop()`)."""

    COMPLETED = "completed"
    CONTACT = "contact"
    STOPPED = "stopped"


@dataclass(frozen=True)
class MotionReport:
    """What really happened. stamps (N,) [s]; q_commanded, q_measured (N, 6); wrenches (N, 6), of several readings
    between two stamps the one with the greatest force.

    contact: the arm's measured state when the guard first felt its force, or None. overruns: command cycles
    that were late by half a cycle or more.
    """

    outcome: MotionOutcome
    stamps: Array
    q_commanded: Array
    q_measured: Array
    wrenches: Array
    contact: JointState | None = None
    overruns: int = 0


@runtime_checkable
class Arm(Device, Protocol):
    """A six-joint position-controlled arm.

    `execute` blocks until standstill and returns what was really sent and measured; the first sample must equal the
    state's `q_commanded` within `arm_checks.START_TOLERANCE` or nothing moves (`LimitError`). Commands go out at
    `rate` [Hz] on an absolute schedule. `stop` brings the arm to a standstill as fast as its limits allow, from the
    last commanded state, and may be called at any time, from any thread. `state(max_age)` raises `StaleDataError` when
    the newest reading is older than max_age [s].

    Anything that ends a motion other than its end, a contact or `stop` is a fault: the arm stands still, latches, and
    raises a `MotionFaultError` that carries the report of what was done. While it is latched, `execute` raises
    `LatchedError` and nothing moves. `reset` takes the latch off after a person has made the robot ready again; it
    rebuilds the connection if need be, never clears a protective stop or an emergency stop itself, and raises
    `DeviceError` as long as the robot is not ready.
    """

    @property
    def rate(self) -> float: ...

    def state(self, max_age: float = 0.1) -> ArmState: ...

    def execute(
        self, trajectory: Trajectory, guard: ContactGuard | None = None, watch: MotionWatch | None = None
    ) -> MotionReport: ...

    def set_payload(self, payload: Payload) -> None: ...

    def stop(self) -> None: ...

    def reset(self) -> None: ...


@dataclass(frozen=True)
class HandState:
    """joints: the hand's joints (n,) in the order of `joint_names`, wrist first: those of its `robots.HandModel`.

    contact_forces: finger -> force [N] on its pads (0 where nothing is touched); the fingers' names are the model's,
    and "palm" where it can be felt. holding: the hand's own judgement that something is
    held. assisted: the hold is the simulation's assisted grip, not friction alone. temperature: of the hottest part
    [deg C], None where the hand cannot tell. fault: what the hand complains of (stalled, over current, ...), in words;
    empty if nothing.
    """

    joints: JointState
    contact_forces: dict[str, float]
    holding: bool
    assisted: bool = False
    temperature: float | None = None
    fault: str = ""


@runtime_checkable
class Hand(Device, Protocol):
    """A dexterous hand. Motions block until done or timed out [s]; a time-out raises `DeviceError` and keeps the grip.

    `open` spreads the fingers, `close` closes until the fingers hold or are
    shut. `stop` freezes the fingers and keeps the grip: it never lets go.
    """

    @property
    def joint_names(self) -> tuple[str, ...]: ...

    def state(self, max_age: float = 0.1) -> HandState: ...

    def open(self, timeout: float = 5.0) -> None: ...

    def close(self, timeout: float = 5.0) -> None: ...

    def stop(self) -> None: ...


@runtime_checkable
class RgbdCamera(Device, Protocol):
    """A calibrated RGB-D camera. `read` returns a frame exposed after the call began, at most max_age [s] old, or
    raises `StaleDataError`; repeated stamps never pass as new frames."""

    @property
    def intrinsics(self) -> CameraIntrinsics: ...

    def read(self, max_age: float = 0.5) -> RgbdFrame: ...


@runtime_checkable
class Person(Protocol):
    """The person at the station: hands the tool over and confirms what software must not decide.

    Every question waits at most `timeout` [s]; no answer is a no. `zone_occupied` and `enabling_switch_held` answer at
    once, from any thread, and are asked all through a motion: a light barrier, a scanner, an enabling switch, or a key
    held down. A station that cannot tell must say True to `zone_occupied`: nothing fast moves then."""

    def request_handover(self, prompt: str, timeout: float) -> bool:
        """Ask for the tool; True once the person says that it lies in the open hand, False on time-out [s]."""
        ...

    def release(self, prompt: str, timeout: float) -> bool:
        """Ask the person to let go and step back; True once they confirm that they are out of reach."""
        ...

    def take_tool(self, prompt: str, timeout: float) -> bool:
        """Ask the person to hold the tool that the hand still grips; True once they say that the hand may open."""
        ...

    def confirm_swing(self, prompt: str, timeout: float) -> bool:
        """Ask whether fast strikes may begin; True once the person confirms it."""
        ...

    def zone_occupied(self) -> bool:
        """Whether anybody is, or may be, within the arm's reach."""
        ...

    def enabling_switch_held(self) -> bool:
        """Whether the person lets the arm move slowly while they are near: the enabling switch is held."""
        ...


@runtime_checkable
class Clock(Protocol):
    """The station's time [s]; a simulation advances it only by moving or sleeping."""

    def now(self) -> float: ...

    def sleep(self, duration: float) -> None: ...


@dataclass(frozen=True)
class Station:
    """Everything a task may touch. robot_serial, camera_serial: who the devices say they are; empty if they cannot."""

    arm: Arm
    hand: Hand
    camera: RgbdCamera
    person: Person
    clock: Clock
    robot_serial: str = ""
    camera_serial: str = ""
