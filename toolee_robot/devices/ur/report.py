"""Records of a probe of a UR controller."""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.devices.ur.protocols.primary import UrKinematics
from toolee_robot.frames import Array
from toolee_robot.types import Payload


@dataclass(frozen=True)
class PortState:
    """Result of connecting to one port.

    Attributes:
        latency: Time to connect [s]; None if it failed.
        problem: Why it failed; empty otherwise.
    """

    latency: float | None
    problem: str = ""


@dataclass(frozen=True)
class UrState:
    """One reading of the robot's state.

    Attributes:
        q: Joint positions, (6,) [rad].
        qd: Joint velocities, (6,) [rad/s].
        tcp_pose: TCP in the controller's base, (6,): position [m], rotation vector [rad].
        tcp_offset: TCP in the flange frame, (6,), likewise; None if this version of PolyScope does not report it.
        payload: Payload in the flange frame; None if this version of PolyScope does not report it.
        robot_mode: RTDE's robot_mode.
        safety_mode: RTDE's safety_mode.
        runtime_state: RTDE's runtime_state.
        robot_status_bits: RTDE's robot_status_bits.
        safety_status_bits: RTDE's safety_status_bits.
        speed_slider: Position of the speed slider, 0 to 1.
        speed_scaling: Actual speed scaling, 0 to 1.
        accelerometer: Mean of the tool's accelerometer, (3,) [m/s^2], axes of the tool, upwards at rest; None if the
            controller does not report it.
    """

    q: Array
    qd: Array
    tcp_pose: Array
    tcp_offset: Array | None
    payload: Payload | None
    robot_mode: int
    safety_mode: int
    runtime_state: int
    robot_status_bits: int
    safety_status_bits: int
    speed_slider: float
    speed_scaling: float
    accelerometer: Array | None = None


@dataclass(frozen=True)
class RtdeQuality:
    """Timing of about a second of RTDE data.

    Attributes:
        asked: Requested rate [Hz].
        rate: Rate by the controller's timestamps [Hz].
        samples: Samples received.
        lost: Samples missing by the timestamps.
        backward: Timestamps that did not advance.
        gap_p99: 99th percentile of the time between two arrivals at this machine [s].
        gap_max: Longest time between two arrivals [s].
        clock_ratio: Seconds of the controller's clock per second of this machine's.
    """

    asked: float
    rate: float
    samples: int
    lost: int
    backward: int
    gap_p99: float
    gap_max: float
    clock_ratio: float


@dataclass(frozen=True)
class UrReport:
    """Everything that a probe has read; None where unknown.

    Attributes:
        host: Address of the controller.
        ports: Result of connecting, by port.
        version: Version of URControl: major, minor, bugfix, build.
        polyscope: Version of PolyScope, as the dashboard reports it.
        model: Model, as the dashboard reports it, without the e of the e-Series.
        serial: Serial number, as the dashboard reports it.
        remote_control: Whether the robot is in remote control; None on a CB3, which has no local mode.
        state: Latest state.
        quality: Timing of the RTDE data.
        kinematics: Calibrated kinematics of the arm.
        problems: What could not be read, and why.
    """

    host: str
    ports: dict[int, PortState]
    version: tuple[int, int, int, int] | None
    polyscope: str | None
    model: str | None
    serial: str | None
    remote_control: bool | None
    state: UrState | None
    quality: RtdeQuality | None
    kinematics: UrKinematics | None
    problems: tuple[str, ...]

    @property
    def reachable(self) -> bool:
        """Whether any port accepted a connection."""
        return any(port.latency is not None for port in self.ports.values())
